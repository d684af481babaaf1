#include <map>

#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/network/message_framer.hpp"
#include "openigtlink_counters.hpp"

namespace py = pybind11;
using burrlab::refuse;
using namespace burrlab::openigtlink;

namespace {

using Metadata = std::map<std::string, std::string>;
using Matrix3 = std::array<std::array<float, 3>, 3>;
using Floats = py::array_t<double, py::array::c_style | py::array::forcecast>;

ByteView view_of(const py::bytes& bytes) {
  const std::string_view text(bytes);
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

py::bytes to_bytes(const Bytes& bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

/// Text of a peer, who may send anything.
py::str to_text(std::string_view text) {
  return py::reinterpret_steal<py::str>(
      PyUnicode_DecodeUTF8(text.data(), py::ssize_t(text.size()), "replace"));
}

/// What the encoders share: the options of a message, as C++ holds them.
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

/// A message with its content decoded, apart from the framer's buffer.
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

/// A framer that decodes: what a decoder refuses counts as dropped.
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

template <class Number>
py::array_t<double> to_array(const std::vector<Number>& shape, const double* values) {
  return py::array_t<double>(std::vector<py::ssize_t>(shape.begin(), shape.end()), values);
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
  if (const auto* sensor = std::get_if<Sensor>(&received.value))
    return to_array(std::vector<std::size_t>{sensor->values.size()}, sensor->values.data());
  if (const auto* array = std::get_if<Ndarray>(&received.value)) {
    if (array->shape.size() > 32)  // NumPy's limit; OpenIGTLink's is 255
      return to_array(std::vector<std::size_t>{array->values.size()}, array->values.data());
    return to_array(array->shape, array->values.data());
  }
  return to_bytes(std::get<Bytes>(received.value));
}

void bind_encoders(py::module_& m) {
  m.def(
      "crc64", [](const py::bytes& data) { return crc64(view_of(data)); }, py::arg("data"),
      "CRC-64 of ECMA-182 as OpenIGTLink uses it.");
  m.def(
      "encode_transform",
      [](const std::string& device_name, const std::array<float, 3>& position, const Matrix3& rotation,
         double timestamp, int version, std::uint32_t message_id, const Metadata& metadata) {
        const Options options(device_name, timestamp, version, message_id, metadata);
        Transform transform;
        transform.position = position;
        for (std::size_t i = 0; i < 9; ++i) transform.rotation[i] = rotation[i / 3][i % 3];
        Bytes out;
        encode_transform(out, options.envelope, transform);
        return to_bytes(out);
      },
      py::arg("device_name"), py::arg("position"), py::kw_only(),
      py::arg("rotation") = Matrix3{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, py::arg("timestamp") = 0.0,
      py::arg("version") = 1, py::arg("message_id") = 0, py::arg("metadata") = Metadata{},
      "A TRANSFORM message: position (x, y, z) [mm] and rotation (3, 3), RAS, float32. timestamp [s] since "
      "1970. ValueError where the message cannot hold it.");
  m.def(
      "encode_sensor",
      [](const std::string& device_name, const std::vector<double>& values, std::uint64_t unit,
         double timestamp, int version, std::uint32_t message_id, const Metadata& metadata) {
        const Options options(device_name, timestamp, version, message_id, metadata);
        Bytes out;
        encode_sensor(out, options.envelope, values.data(), values.size(), unit);
        return to_bytes(out);
      },
      py::arg("device_name"), py::arg("values"), py::kw_only(), py::arg("unit") = newton,
      py::arg("timestamp") = 0.0, py::arg("version") = 1, py::arg("message_id") = 0,
      py::arg("metadata") = Metadata{},
      "A SENSOR message of up to 255 float64; `unit` is OpenIGTLink's 64-bit field, newton unless said. "
      "ValueError where the message cannot hold it.");
  m.def(
      "encode_ndarray_float64",
      [](const std::string& device_name, const Floats& values, double timestamp, int version,
         std::uint32_t message_id, const Metadata& metadata) {
        const Options options(device_name, timestamp, version, message_id, metadata);
        std::vector<std::uint16_t> shape;
        for (py::ssize_t axis = 0; axis < values.ndim(); ++axis) {
          if (values.shape(axis) > 65535)
            refuse("every side of values", "at most 65535", double(values.shape(axis)));
          shape.push_back(std::uint16_t(values.shape(axis)));
        }
        Bytes out;
        encode_ndarray_float64(out, options.envelope, values.data(), std::size_t(values.size()), shape.data(),
                               shape.size());
        return to_bytes(out);
      },
      py::arg("device_name"), py::arg("values"), py::kw_only(), py::arg("timestamp") = 0.0,
      py::arg("version") = 1, py::arg("message_id") = 0, py::arg("metadata") = Metadata{},
      "An NDARRAY message of float64, at least one dimension. ValueError where the message cannot hold it.");
  m.def(
      "encode_ndarray_uint8",
      [](const std::string& device_name, const py::bytes& data, double timestamp, int version,
         std::uint32_t message_id, const Metadata& metadata) {
        const Options options(device_name, timestamp, version, message_id, metadata);
        Bytes out;
        encode_ndarray_uint8(out, options.envelope, view_of(data));
        return to_bytes(out);
      },
      py::arg("device_name"), py::arg("data"), py::kw_only(), py::arg("timestamp") = 0.0,
      py::arg("version") = 1, py::arg("message_id") = 0, py::arg("metadata") = Metadata{},
      "An NDARRAY message of uint8 that holds `data`: its length in 8 bytes (ours), the bytes, zeros up to a "
      "whole number of rows. ValueError where the message cannot hold it.");
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

  py::class_<Framer>(m, "MessageFramer", R"doc(Bytes, as they come from a socket, into OpenIGTLink messages.

Parameters
----------
largest_body : int
    Longer messages are passed over [bytes].

Raises
------
ValueError
    If `largest_body` is below 48 or not below 4 GiB.
)doc")
      .def(py::init<std::size_t>(), py::arg("largest_body") = std::size_t(1) << 20)
      .def(
          "feed",
          [](Framer& framer, const py::bytes& data) {
            const ByteView bytes = view_of(data);
            const py::gil_scoped_release release;
            return framer.feed(bytes);
          },
          py::arg("data"), "The messages that these bytes complete.")
      .def_property_readonly(
          "broken", [](const Framer& f) { return f.framer.broken(); },
          "The place in the stream is lost: nothing more is read until `restart`.")
      .def(
          "restart", [](Framer& f) { f.framer.restart(); }, "A new connection begins.")
      .def_property_readonly(
          "counters", [](const Framer& f) { return to_dict(f.counters()); },
          "Messages, and what was dropped, by reason; a copy.");
}

}  // namespace

void bind_openigtlink(py::module_& m) {
  bind_encoders(m);
  bind_framer(m);
}
