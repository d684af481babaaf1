#include <map>

#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/network/message_framer.hpp"
#include "burrlab/network/network_device.hpp"

using namespace burrlab::openigtlink;

namespace {

using Metadata = std::map<std::string, std::string>;
using Matrix3 = std::array<std::array<float, 3>, 3>;

ByteView view_of(const py::bytes& bytes) {
  const std::string_view text(bytes);
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

py::bytes to_bytes(const Bytes& bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

/// The options that all encoders share, in the form of C++.
struct Options {
  Options(const std::string& device_name, double timestamp, int version, std::uint32_t message_id,
          const Metadata& metadata)
      : name(device_name) {
    if (!(timestamp >= 0.0 && timestamp < 4294967296.0)) refuse("timestamp", "0 to 2^32 s", timestamp);
    for (const auto& [key, value] : metadata) {
      bool ascii = true;
      for (const char c : value) ascii = ascii && static_cast<unsigned char>(c) < 128;
      entries.push_back({key, value, std::uint16_t(ascii ? 3 : 106)});
    }
    envelope = {name, std::uint64_t(timestamp * 4294967296.0), version, message_id, &entries};
  }
  Options(const Options&) = delete;
  std::string name;
  std::vector<MetadataEntry> entries;
  Envelope envelope;
};

/// A message with its decoded content, independent of the framer's buffer.
struct Received {
  Header header;
  std::uint32_t message_id;
  std::vector<MetadataEntry> metadata;
  std::variant<Transform, Sensor, Ndarray, Bytes> value;
};

Drop decode(const Message& message, Received& received) {
  received.header = message.header;
  received.message_id = message.message_id;
  read_metadata(message, received.metadata);
  Drop reason = decode_transform(message, received.value.emplace<Transform>());
  if (reason == Drop::wrong_type) reason = decode_sensor(message, received.value.emplace<Sensor>());
  if (reason == Drop::wrong_type) reason = decode_ndarray_float64(message, received.value.emplace<Ndarray>());
  if (reason == Drop::bad_scalar) {
    ByteView text;
    reason = decode_ndarray_uint8(message, text);
    if (reason == Drop::none) received.value = Bytes(text.data, text.data + text.size);
  }
  return reason;
}

/// A framer that decodes; messages that a decoder refuses count as dropped.
struct Framer {
  explicit Framer(std::size_t largest_body) : framer(largest_body) {}

  std::vector<Received> feed(ByteView bytes) {
    std::vector<Received> messages;
    framer.feed(bytes, [&](const Message& message) {
      Received received;
      const Drop reason = decode(message, received);
      ++refused[std::size_t(reason)];
      if (reason == Drop::none) messages.push_back(std::move(received));
    });
    return messages;
  }
  Counters counters() const {
    Counters all = framer.counters();
    all.messages = refused[0];
    for (std::size_t i = 1; i < drop_reasons; ++i) all.dropped[i] += refused[i];
    return all;
  }
  MessageFramer framer;
  std::array<std::uint64_t, drop_reasons> refused{};
};

/// Counters as a dictionary: messages, and drops by reason.
std::map<std::string, std::uint64_t> counts_of(const Counters& counters) {
  std::map<std::string, std::uint64_t> out{{"messages", counters.messages}};
  for (std::size_t i = 1; i < drop_reasons; ++i) out[drop_name(Drop(i))] = counters.dropped[i];
  return out;
}

py::object to_python(const Received& received) {
  if (const auto* transform = std::get_if<Transform>(&received.value)) {
    py::array_t<float> matrix({4, 4});
    for (int row = 0; row < 4; ++row)
      for (int column = 0; column < 4; ++column)
        matrix.mutable_at(row, column) = row == 3      ? float(column == 3)
                                         : column == 3 ? transform->position[std::size_t(row)]
                                                       : transform->rotation[std::size_t(3 * row + column)];
    return std::move(matrix);
  }
  if (const auto* sensor = std::get_if<Sensor>(&received.value)) return to_array(sensor->values);
  if (const auto* array = std::get_if<Ndarray>(&received.value)) {
    if (array->shape.size() > 32)  // NumPy's limit; OpenIGTLink's is 255
      return to_array(array->values);
    return to_array(array->values.data(), {array->shape.begin(), array->shape.end()});
  }
  return to_bytes(std::get<Bytes>(received.value));
}

/// Binds an encoder of a device's message: its own arguments, then the options that all share.
template <class... Given, class... Extra>
void def_encoder(py::module_& m, const char* name, void (*encode)(Bytes&, const Envelope&, Given...),
                 const Extra&... extra) {
  m.def(
      name,
      [encode](const std::string& device_name, Given... given, double timestamp, int version,
               std::uint32_t message_id, const Metadata& metadata) {
        const Options options(device_name, timestamp, version, message_id, metadata);
        Bytes out;
        encode(out, options.envelope, given...);
        return to_bytes(out);
      },
      "device_name"_a, extra..., "timestamp"_a = 0.0, "version"_a = 1, "message_id"_a = 0,
      "metadata"_a = Metadata{});
}

void put_transform(Bytes& out, const Envelope& envelope, const std::array<float, 3>& position,
                   const Matrix3& rotation) {
  Transform transform;
  transform.position = position;
  for (std::size_t i = 0; i < 9; ++i) transform.rotation[i] = rotation[i / 3][i % 3];
  encode_transform(out, envelope, transform);
}

void put_sensor(Bytes& out, const Envelope& envelope, const std::vector<double>& values, std::uint64_t unit) {
  encode_sensor(out, envelope, values.data(), values.size(), unit);
}

void put_float64(Bytes& out, const Envelope& envelope, const Reals& values) {
  std::vector<std::uint16_t> shape;
  for (py::ssize_t axis = 0; axis < values.ndim(); ++axis) {
    if (values.shape(axis) > 65535)
      refuse("every side of values", "at most 65535", double(values.shape(axis)));
    shape.push_back(std::uint16_t(values.shape(axis)));
  }
  encode_ndarray_float64(out, envelope, values.data(), std::size_t(values.size()), shape.data(),
                         shape.size());
}

void put_uint8(Bytes& out, const Envelope& envelope, const py::bytes& data) {
  encode_ndarray_uint8(out, envelope, view_of(data));
}

void bind_encoders(py::module_& m) {
  m.def(
      "crc64", [](const py::bytes& data) { return crc64(view_of(data)); }, "data"_a,
      "CRC-64 of ECMA-182 as OpenIGTLink uses it.");
  def_encoder(m, "encode_transform", &put_transform, "position"_a, py::kw_only(),
              "rotation"_a = Matrix3{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}},
              "A TRANSFORM message: position (x, y, z) [mm] and rotation (3, 3), RAS, float32; timestamp [s] "
              "since 1970. ValueError if the message cannot hold them.");
  def_encoder(m, "encode_sensor", &put_sensor, "values"_a, py::kw_only(), "unit"_a = newton,
              "A SENSOR message of up to 255 float64; `unit` is OpenIGTLink's 64-bit field, newton by "
              "default. ValueError if the message cannot hold them.");
  def_encoder(
      m, "encode_ndarray_float64", &put_float64, "values"_a, py::kw_only(),
      "An NDARRAY message of float64, at least one dimension. ValueError if the message cannot hold them.");
  def_encoder(m, "encode_ndarray_uint8", &put_uint8, "data"_a, py::kw_only(),
              "An NDARRAY message of uint8: the length of `data` in 8 bytes (ours), the bytes, and zeros up "
              "to a whole number of rows. ValueError if the message cannot hold them.");
}

void bind_framer(py::module_& m) {
  py::class_<Received>(m, "ReceivedMessage", "A TRANSFORM, SENSOR or NDARRAY message.")
      .def_property_readonly("type", [](const Received& r) { return to_text(r.header.type.view()); })
      .def_property_readonly("device_name",
                             [](const Received& r) { return to_text(r.header.device_name.view()); })
      .def_property_readonly(
          "timestamp", [](const Received& r) { return timestamp_seconds(r.header.timestamp); },
          "[s] since 1970; 0 is none")
      .def_property_readonly(
          "version", [](const Received& r) { return r.header.version; }, "Of the header, 1 or 2")
      .def_readonly("message_id", &Received::message_id)
      .def_property_readonly(
          "metadata",
          [](const Received& r) {
            py::dict out;
            for (const MetadataEntry& entry : r.metadata) out[to_text(entry.key)] = to_text(entry.value);
            return out;
          },
          "Keys and values as text; a copy")
      .def_property_readonly("value", &to_python,
                             "TRANSFORM: (4, 4) float32, RAS [mm]. SENSOR: (n,) float64. NDARRAY: float64 "
                             "array, or the bytes of `encode_ndarray_uint8`. A copy.")
      .def_property_readonly(
          "unit",
          [](const Received& r) {
            const auto* sensor = std::get_if<Sensor>(&r.value);
            return sensor ? sensor->unit : 0;
          },
          "The 64-bit unit of a SENSOR; 0 otherwise");

  py::class_<Framer>(m, "MessageFramer",
                     "Cuts bytes from a socket into OpenIGTLink messages. Messages longer than "
                     "`largest_body` [bytes] are skipped. ValueError if it is below 48 or not below 4 GiB.")
      .def(py::init<std::size_t>(), "largest_body"_a = std::size_t(1) << 20)
      .def(
          "feed",
          [](Framer& framer, const py::bytes& data) {
            const ByteView bytes = view_of(data);
            const py::gil_scoped_release release;
            return framer.feed(bytes);
          },
          "data"_a, "The messages that these bytes complete.")
      .def_property_readonly(
          "broken", [](const Framer& f) { return f.framer.broken(); },
          "The place in the stream is lost: nothing more is read until `restart`.")
      .def(
          "restart", [](Framer& f) { f.framer.restart(); }, "For a new connection.")
      .def_property_readonly(
          "counters", [](const Framer& f) { return counts_of(f.counters()); },
          "Messages, and drops by reason; a copy.");
}

std::map<std::string, std::uint64_t> counts_of(const ReaderCounters& counters) {
  auto out = counts_of(counters.messages);
  out["other_type"] = counters.other_type;
  out["other_device"] = counters.other_device;
  out["connections"] = counters.connections;
  out["broken"] = counters.broken;
  return out;
}

void bind_igtl_device(py::module_& m) {
  py::class_<IgtlDevice, MailboxDevice, std::shared_ptr<IgtlDevice>>(
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
      .def_property_readonly("connected", &IgtlDevice::connected)
      .def_property_readonly(
          "counters", [](const IgtlDevice& d) { return counts_of(d.counters()); },
          "Messages, drops by reason, connections; a copy.")
      .def("stop", &IgtlDevice::stop, no_gil, "Ends the connection.");
}

void bind_vrpn_reader(py::module_& m) {
  using Reader = burrlab::vrpn::Reader;
  const auto read = [](Reader& reader, const py::bytes& data, bool datagram) {
    py::list out;
    const Reader::Receive receive = [&](const burrlab::vrpn::Message& one) {
      out.append(py::make_tuple(int(one.kind), one.sender, one.number, one.pressed, one.values,
                                timestamp_seconds(one.timestamp), to_text(one.text)));
    };
    if (datagram)
      reader.feed_datagram(view_of(data), receive);
    else
      reader.feed(view_of(data), receive);
    return out;
  };
  py::class_<Reader>(
      m, "VrpnReader",
      "Reads a VRPN peer's cookie and messages: (kind, sender, number, pressed, values, time [s], "
      "text); for tests.")
      .def(py::init<std::vector<std::string>, std::size_t>(), "senders"_a, "largest_payload"_a = 65536)
      .def(
          "feed", [=](Reader& r, const py::bytes& data) { return read(r, data, false); }, "data"_a)
      .def(
          "feed_datagram", [=](Reader& r, const py::bytes& data) { return read(r, data, true); }, "data"_a)
      .def_property_readonly("broken", &Reader::broken)
      .def_property_readonly("other_sender", &Reader::other_sender)
      .def_property_readonly("other_type", &Reader::other_type)
      .def_property_readonly("lost", &Reader::lost)
      .def_property_readonly("counters", [](const Reader& r) { return counts_of(r.counters()); });
}

void bind_vrpn_device(py::module_& m) {
  py::class_<VrpnDevice, MailboxDevice, std::shared_ptr<VrpnDevice>>(
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
           "name"_a, "host"_a, "port"_a = burrlab::vrpn::default_port, py::kw_only(), "tcp"_a = false,
           "on_button"_a = py::none(), "lost_after"_a = 100.0, no_gil)
      .def_property_readonly("connected", &VrpnDevice::connected)
      .def_property_readonly("note", &VrpnDevice::note,
                             "That the server's minor version is another, else empty.")
      .def_property_readonly(
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

void bind_openigtlink(py::module_& m) {
  bind_encoders(m);
  bind_framer(m);
  bind_igtl_device(m);
  bind_vrpn_reader(m);
  bind_vrpn_device(m);
}
