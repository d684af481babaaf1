#include <optional>

#include "bindings.hpp"
#include "burrlab/network/igtl_device.hpp"
#include "openigtlink_counters.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

std::map<std::string, std::uint64_t> to_dict(const ReaderCounters& counters) {
  auto out = ::to_dict(counters.messages);
  out["other_type"] = counters.other_type;
  out["other_device"] = counters.other_device;
  out["connections"] = counters.connections;
  out["broken"] = counters.broken;
  return out;
}

}  // namespace

void bind_transform_reader(py::module_& m) {
  py::class_<NetworkPose>(m, "NetworkPose", "A TRANSFORM, turned into the bone frame on its arrival.")
      .def_property_readonly(
          "position", [](const NetworkPose& p) { return py::array_t<double>(3, p.position.data()); },
          "(3,) bone frame, LPS [mm]; a copy")
      .def_property_readonly(
          "rotation", [](const NetworkPose& p) { return py::array_t<double>({3, 3}, p.rotation.data()); },
          "(3, 3), both frames LPS; a copy")
      .def_property_readonly(
          "timestamp", [](const NetworkPose& p) { return openigtlink::timestamp_seconds(p.timestamp); },
          "The sender's [s] since 1970; 0 is none")
      .def_property_readonly(
          "arrival", [](const NetworkPose& p) { return 1e-9 * double(p.arrival); },
          "Steady clock [s], as time.monotonic() on Linux")
      .def_readonly("count", &NetworkPose::count, "1 for the first")
      .def_property_readonly("on", [](const NetworkPose& p) { return p.on != 0; }, "The burr turns.");

  py::class_<TransformReader>(m, "TransformReader",
                              R"doc(A TRANSFORM stream of an OpenIGTLink server, read by a thread of its own.

Connects to the server, and anew after a pause of 0.1 to 1 s when the connection ends or its framing is lost.

Parameters
----------
host : str
    Name or address.
port : int
device_name : str
    Read this device only; empty for any. The burr is on unless the name that comes ends in ``_off``.

Raises
------
ValueError
    If the host has no address, the port is not 1 to 65535 or the name has over 20 bytes.
)doc")
      .def(py::init([](const std::string& host, int port, const std::string& device_name) {
             return std::make_unique<TransformReader>(host, port, device_name);
           }),
           py::arg("host"), py::arg("port"), py::kw_only(), py::arg("device_name") = "",
           py::call_guard<py::gil_scoped_release>())
      .def(
          "newest",
          [](const TransformReader& reader) -> std::optional<NetworkPose> {
            NetworkPose pose;
            if (!reader.newest(pose)) return std::nullopt;
            return pose;
          },
          "The newest pose; None where none came yet.")
      .def_property_readonly("connected", &TransformReader::connected)
      .def_property_readonly(
          "counters", [](const TransformReader& r) { return to_dict(r.counters()); },
          "Messages, what was dropped, by reason, connections; a copy.")
      .def("stop", &TransformReader::stop, py::call_guard<py::gil_scoped_release>(), "Ends the thread.");

  py::class_<IgtlDevice, MailboxDevice, std::shared_ptr<IgtlDevice>>(
      m, "IgtlDevice", R"doc(A device that a standard OpenIGTLink server's TRANSFORM stream drives.

The position is rounded once, on arrival; the burr is on unless the device name that comes ends in ``_off`` (our
choice). The velocity, which TRANSFORM does not carry, is the difference of two poses over that of their time stamps.

Parameters
----------
host : str
    Name or address.
port : int
device_name : str
    Read this device only; empty for any.
lost_after : float
    A position that old is lost, and the session stops [ms].

Raises
------
ValueError
    If the host has no address, the port is not 1 to 65535, the name has over 20 bytes or `lost_after` is not
    positive.
)doc")
      .def(py::init([](const std::string& host, int port, const std::string& device_name, double lost_after) {
             return std::make_shared<IgtlDevice>(host, port, device_name, lost_after);
           }),
           py::arg("host"), py::arg("port"), py::kw_only(), py::arg("device_name") = "",
           py::arg("lost_after") = 100.0, py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("connected", &IgtlDevice::connected)
      .def_property_readonly(
          "counters", [](const IgtlDevice& d) { return to_dict(d.counters()); },
          "Messages, what was dropped, by reason, connections; a copy.")
      .def("stop", &IgtlDevice::stop, py::call_guard<py::gil_scoped_release>(), "Ends the connection.");
}
