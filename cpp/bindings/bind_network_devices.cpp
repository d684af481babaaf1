#include <map>

#include "bindings.hpp"
#include "network/network_device.hpp"
#include "network/vrpn_log.hpp"

namespace {

/// Poses accepted, drops by reason, and what became of the connections.
std::map<std::string, std::uint64_t> counts_of(const ReaderCounters& counters) {
  std::map<std::string, std::uint64_t> out{{"messages", counters.messages.messages}};
  for (std::size_t i = 1; i < openigtlink::drop_reasons; ++i)
    out[openigtlink::drop_name(openigtlink::Drop(i))] = counters.messages.dropped[i];
  out["other_type"] = counters.other_type;
  out["other_device"] = counters.other_device;
  out["connections"] = counters.connections;
  out["broken"] = counters.broken;
  return out;
}

void bind_igtl_device(py::module_& m) {
  Class<IgtlDevice, MailboxDevice, std::shared_ptr<IgtlDevice>>(
      m, "IgtlDevice", R"doc(A device that a standard OpenIGTLink server's TRANSFORM stream drives.

The position is rounded once, on arrival. The burr is on unless the sender's device name ends in ``_off`` (our
choice). The velocity, which TRANSFORM does not carry, is the difference of two poses over that of their
time stamps. Of PLUS's haptic devices the tools Stylus, StylusVelocity and Buttons are read, and each Stylus is
answered with the force on the hand (docs/network.md).

Parameters
----------
host : str
    Name or address.
port : int
device_name : str
    Only this device is read; empty for any.
lost_after : float
    Age at which a position is lost, and the session stops [ms].
on_button : int, optional
    The burr turns while this button of PLUS, 0 to 2, is pressed; default: unless the name ends in ``_off``.

Raises
------
ValueError
    If the host has no address, the port is not 1 to 65535, the name has over 20 bytes, the button is not 0 to
    7 or `lost_after` is not positive.
)doc")
      .def(py::init([](const std::string& host, int port, const std::string& device_name, double lost_after,
                       std::optional<int> on_button) {
             return std::make_shared<IgtlDevice>(host, port, device_name, lost_after, button_of(on_button));
           }),
           "host"_a, "port"_a, py::kw_only(), "device_name"_a = "", "lost_after"_a = 100.0,
           "on_button"_a = py::none(), no_gil)
      .def_readonly("connected", &IgtlDevice::connected)
      .def_readonly(
          "counters", [](const IgtlDevice& d) { return counts_of(d.counters()); },
          "Messages, drops by reason, connections; a copy.")
      .def("stop", &IgtlDevice::stop, no_gil, "Ends the connection.");
}

/// A table of a log: kind, sender, times, numbers, values of shape (messages, columns).
py::tuple to_tuple(const vrpn::LoggedMessages& messages) {
  static constexpr const char* kinds[] = {"pose", "velocity", "button", "", "force"};
  const auto rows = py::ssize_t(messages.times.size());
  const auto columns = rows ? py::ssize_t(messages.values.size()) / rows : 0;
  return py::make_tuple(kinds[std::size_t(messages.kind)], to_text(messages.sender), to_array(messages.times),
                        to_array(messages.numbers), to_array(messages.values.data(), {rows, columns}));
}

void bind_vrpn_log(py::module_& m) {
  m.def(
      "read_vrpn_log",
      [](const py::bytes& file) {
        const std::string_view bytes(file);
        const vrpn::Log log = without_gil([&] {
          return vrpn::read_log({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()});
        });
        py::list tables;
        py::dict others;
        for (const vrpn::LoggedMessages& messages : log.messages) tables.append(to_tuple(messages));
        for (const auto& [name, count] : log.others) others[to_text(name)] = count;
        return py::make_tuple(tables, others);
      },
      "file"_a,
      "Tables of a log of VRPN, (kind, sender, times [us since epoch], numbers of sensors or buttons, "
      "values), and the number of messages of each other type. ValueError at a message that is not whole.");
}

void bind_vrpn_device(py::module_& m) {
  Class<VrpnDevice, MailboxDevice, std::shared_ptr<VrpnDevice>>(
      m, "VrpnDevice",
      R"doc(A device that sensor 0 of a VRPN server's Tracker, and the Buttons of that name, drive.

VRPN's metres become millimetres. It states no axes: they are the bone's, unless the session's frame turns
them. Without Velocity messages the velocity is the difference of two poses over that of their time stamps.

Parameters
----------
name : str
    Of the Tracker.
host : str
    Name or address of the server.
port : int
    Its port.
tcp : bool
    Connect directly and do without UDP, as through a tunnel. Default: ask the server by UDP to connect to this
    machine, as VRPN does; poses then come over UDP.
on_button : int, optional
    The burr turns while this button, 0 to 7, is pressed; default always.
lost_after : float
    Age at which a position is lost, and the session stops [ms].

Raises
------
ValueError
    If the host has no address, the port is not 1 to 65535, the name is empty or has over 99 bytes, the button
    is not 0 to 7 or `lost_after` is not positive.
)doc")
      .def(py::init([](const std::string& name, const std::string& host, int port, bool tcp,
                       std::optional<int> on_button, double lost_after) {
             const VrpnSettings settings{port, tcp, button_of(on_button), lost_after};
             return std::make_shared<VrpnDevice>(name, host, settings);
           }),
           "name"_a, "host"_a, "port"_a = vrpn::default_port, py::kw_only(), "tcp"_a = false,
           "on_button"_a = py::none(), "lost_after"_a = 100.0, no_gil)
      .def_readonly("connected", &VrpnDevice::connected)
      .def_readonly("note", &VrpnDevice::note, "That the server's minor version is another, else empty.")
      .def_readonly(
          "counters",
          [](const VrpnDevice& d) {
            const ReaderCounters counters = d.counters();
            auto out = counts_of(counters);
            out["datagrams"] = counters.datagrams;
            out["lost"] = counters.lost;
            return out;
          },
          "Poses, drops by reason, connections, UDP packets and messages lost over UDP; a copy.")
      .def("stop", &VrpnDevice::stop, no_gil, "Ends the connection.");
}

}  // namespace

void bind_network_devices(py::module_& m) {
  bind_igtl_device(m);
  bind_vrpn_device(m);
  bind_vrpn_log(m);
}
