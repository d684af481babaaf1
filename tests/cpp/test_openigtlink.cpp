// OpenIGTLink messages: the checksum, bytes written out by hand, round trips, and what is refused.
#include "burrlab/network/openigtlink.hpp"

#include <algorithm>
#include <cstring>
#include <limits>

#include "burrlab/network/bone_frame.hpp"
#include "burrlab/network/message_framer.hpp"
#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab::openigtlink;

namespace {

Message message_of(const Bytes& bytes) {
  Message message;
  Header header;
  CHECK(decode_header({bytes.data(), bytes.size()}, header) == Drop::none);
  const ByteView body{bytes.data() + header_size, bytes.size() - header_size};
  CHECK(header.crc == crc64(body));
  CHECK(decode_body(header, body, message) == Drop::none);
  return message;
}

void test_checksum() {
  const char* digits = "123456789";  // the check value that catalogues of checksums give for ECMA-182
  CHECK(crc64({reinterpret_cast<const std::uint8_t*>(digits), 9}) == 0x6C40DF5F0B497347u);
  CHECK(crc64({}) == 0);
}

void test_transform_bytes() {
  Bytes bytes;
  Transform transform;
  transform.rotation = {1, 2, 3, 4, 5, 6, 7, 8, 9};
  transform.position = {-10.5f, 11, 12};
  encode_transform(bytes, {"burr", timestamp_of(7, 500000000)}, transform);
  CHECK(bytes.size() == 58 + 48);
  CHECK(std::memcmp(bytes.data(), "\0\1TRANSFORM\0\0\0burr\0\0\0\0", 22) == 0);
  CHECK(std::memcmp(bytes.data() + 34, "\0\0\0\7\x80\0\0\0\0\0\0\0\0\0\0\x30", 16) == 0);
  CHECK(std::memcmp(bytes.data() + 58, "\x3F\x80\0\0\x40\x80\0\0\x40\xE0\0\0", 12) ==
        0);  // 1, 4, 7: a column
  CHECK(std::memcmp(bytes.data() + 58 + 36, "\xC1\x28\0\0", 4) == 0);
}

void test_round_trips() {
  const std::vector<MetadataEntry> metadata{{"unit", "mm"}, {"", ""}, {"name", "gr\xC3\xBC\xC3\x9F", 106}};
  for (const int version : {1, 2}) {
    Envelope envelope{"a device of 20 bytes", timestamp_of(1700000000, 1), version, 77};
    if (version == 2) envelope.metadata = &metadata;
    Transform transform, transform_back;
    transform.position = {1e-30f, -3.4e38f, 0.1f};
    Bytes bytes;
    encode_transform(bytes, envelope, transform);
    Message message = message_of(bytes);
    CHECK(message.header.device_name.view() == envelope.device_name);
    CHECK(message.header.timestamp == envelope.timestamp && message.header.version == version);
    CHECK(message.message_id == (version == 2 ? 77u : 0u));
    CHECK(decode_transform(message, transform_back) == Drop::none);
    CHECK(transform_back.rotation == transform.rotation && transform_back.position == transform.position);
    std::vector<MetadataEntry> entries;
    CHECK(read_metadata(message, entries) == Drop::none);
    CHECK(entries.size() == (version == 2 ? 3u : 0u));
    if (version == 2)
      CHECK(entries[2].key == "name" && entries[2].value == metadata[2].value && entries[2].encoding == 106);

    const double values[] = {0.1, -2.0, 9007199254740991.0};
    bytes.clear();
    encode_sensor(bytes, envelope, values, 3);
    Sensor sensor;
    CHECK(decode_sensor(message_of(bytes), sensor) == Drop::none);
    CHECK(sensor.unit == newton && sensor.values == std::vector<double>(values, values + 3));

    const double bits[] = {std::numeric_limits<double>::quiet_NaN(), 1, 2, 3, 4, -0.0};
    const std::uint16_t shape[] = {2, 3};
    bytes.clear();
    encode_ndarray_float64(bytes, envelope, bits, 6, shape, 2);
    Ndarray array;
    CHECK(decode_ndarray_float64(message_of(bytes), array) == Drop::none);
    CHECK(array.shape == std::vector<std::uint16_t>({2, 3}));
    CHECK(std::memcmp(array.values.data(), bits, sizeof bits) == 0);
  }
}

void test_byte_strings() {
  for (const std::size_t length : {0, 1, 65526, 65527, 65528, 131062, 131063, 1000003}) {
    Bytes text(length), bytes;
    for (std::size_t i = 0; i < length; ++i) text[i] = std::uint8_t(i * 7 + i / 256);
    encode_ndarray_uint8(bytes, {"digest"}, {text.data(), length});
    ByteView back;
    const Message message = message_of(bytes);
    CHECK(decode_ndarray_uint8(message, back) == Drop::none);
    CHECK(back.size == length && (length == 0 || std::memcmp(back.data, text.data(), length) == 0));
    CHECK(message.content.data[1] == (length + 8 <= 65535 ? 1 : 2));
    Ndarray array;
    CHECK(decode_ndarray_float64(message, array) == Drop::bad_scalar);
  }
}

void test_refusals() {
  Bytes bytes{1, 2, 3};
  Transform transform;
  const double values[256] = {};
  const std::vector<MetadataEntry> metadata{{"a", "b"}};
  const std::string long_key(65536, 'k');
  const std::vector<MetadataEntry> long_metadata{{long_key, ""}}, many(8192);
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 3}, transform), "version must be 1 or 2, got 3");
  CHECK_THROWS(encode_transform(bytes, {"a name of 21 bytes...", 0}, transform),
               "length of device_name must be at most 20, got 21");
  CHECK_THROWS(encode_transform(bytes, {std::string_view("a\0b", 3), 0}, transform),
               "device_name must hold no zero byte, got one after 'a'");
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 1, 0, &metadata}, transform),
               "version must be 2 for a message with metadata, got 1");
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 2, 0, &long_metadata}, transform),
               "length of a metadata key must be at most 65535, got 65536");
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 2, 0, &many}, transform),
               "number of metadata entries must be at most 8191, got 8192");
  CHECK_THROWS(encode_sensor(bytes, {"x"}, values, 256), "number of values must be at most 255, got 256");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS(encode_sensor(bytes, {"x"}, &nan, 1), "every value must be finite, got nan");
  transform.position[1] = std::numeric_limits<float>::infinity();
  CHECK_THROWS(encode_transform(bytes, {"x"}, transform), "every number of position must be finite, got inf");
  transform.rotation[8] = std::numeric_limits<float>::quiet_NaN();
  CHECK_THROWS(encode_transform(bytes, {"x"}, transform), "every number of rotation must be finite, got nan");
  const std::uint16_t shape[] = {2, 3};
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 5, shape, 2),
               "product of shape must be the number of values, got 5");
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 0, shape, 0),
               "number of dimensions must be 1 to 255, got 0");
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 65536),
               "number of values in one dimension must be at most 65535, got 65536");
  CHECK_THROWS(encode_ndarray_uint8(bytes, {"x"}, {nullptr, longest_byte_string + 1}),
               "length of bytes must be at most 4294836217, got 4294836218");
  CHECK(bytes == Bytes({1, 2, 3}));
}

Bytes transform_message(float x, int version = 1, std::string_view type = "") {
  Bytes bytes;
  Transform transform;
  transform.position[0] = x;
  encode_transform(bytes, {"burr", 0, version}, transform);
  if (!type.empty()) {
    std::fill(bytes.begin() + 2, bytes.begin() + 14, std::uint8_t(0));
    std::copy(type.begin(), type.end(), bytes.begin() + 2);
  }
  return bytes;
}

void set_body_size(Bytes& bytes, std::uint64_t size) {
  for (int i = 0; i < 8; ++i) bytes[42 + i] = std::uint8_t(size >> (56 - 8 * i));
}

void sign(Bytes& bytes) {  // the checksum anew after the body was changed
  const std::uint64_t crc = crc64({bytes.data() + header_size, bytes.size() - header_size});
  for (int i = 0; i < 8; ++i) bytes[50 + i] = std::uint8_t(crc >> (56 - 8 * i));
}

/// Feeds `stream` in pieces; the x of the TRANSFORMs that came out.
std::vector<float> positions(MessageFramer& framer, const Bytes& stream, std::size_t piece) {
  std::vector<float> found;
  for (std::size_t at = 0; at < stream.size(); at += piece) {
    framer.feed({stream.data() + at, std::min(piece, stream.size() - at)}, [&](const Message& message) {
      Transform transform;
      if (decode_transform(message, transform) == Drop::none) found.push_back(transform.position[0]);
    });
  }
  return found;
}

Bytes operator+(Bytes a, const Bytes& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

void test_framer() {
  Bytes wrong = transform_message(2);
  wrong[70] ^= 1;
  Bytes image = transform_message(2, 1, "IMAGE");  // passed over whatever its size
  image.resize(header_size + 3000000);
  set_body_size(image, 3000000);
  Bytes longer = transform_message(2, 1, "NDARRAY");
  longer.resize(header_size + 1001);
  set_body_size(longer, 1001);
  const Bytes stream = transform_message(1) + wrong + transform_message(3, 2) + image + transform_message(4) +
                       longer + transform_message(5);
  for (const std::size_t piece : {std::size_t(1), std::size_t(57), std::size_t(1000), stream.size()}) {
    MessageFramer framer(1000);
    CHECK(positions(framer, stream, piece) == std::vector<float>({1, 3, 4, 5}));
    const Counters& counters = framer.counters();
    CHECK(counters.messages == 4 && counters.all_dropped() == 3);
    CHECK(counters[Drop::bad_crc] == 1 && counters[Drop::unknown_type] == 1 &&
          counters[Drop::oversized] == 1);
    CHECK(framer.memory() <= header_size + 1000 && !framer.broken());
  }
}

void test_lost_framing() {
  struct Case {
    std::size_t at;
    std::uint8_t value;
    Drop reason;
  };
  for (const Case& each :
       {Case{1, 3, Drop::bad_version}, Case{0, 1, Drop::bad_version}, Case{2, 0, Drop::bad_type},
        Case{2, 7, Drop::bad_type}, Case{2, 0xC3, Drop::bad_type}, Case{13, 'x', Drop::bad_type},
        Case{44, 1, Drop::implausible_size}}) {
    Bytes bytes = transform_message(1);
    bytes[each.at] = each.value;
    MessageFramer framer;
    CHECK(positions(framer, bytes + transform_message(2), 33).empty());
    CHECK(framer.broken() && framer.counters()[each.reason] == 1 && framer.counters().all_dropped() == 1);
    framer.restart();
    CHECK(positions(framer, transform_message(3), 33) == std::vector<float>({3}));
  }
  MessageFramer framer;  // bytes missing within a body: that message's checksum, then no header
  Bytes holed = transform_message(1);
  holed.erase(holed.begin() + 80, holed.begin() + 90);
  CHECK(positions(framer, holed + transform_message(2) + transform_message(3), 1000).empty());
  CHECK(framer.broken() && framer.counters()[Drop::bad_crc] == 1 && framer.counters().all_dropped() == 2);

  MessageFramer cut;
  Bytes half = transform_message(1);
  half.resize(100);
  positions(cut, half, 1000);
  cut.restart();
  CHECK(cut.counters()[Drop::truncated] == 1);
  CHECK(positions(cut, transform_message(2), 1000) == std::vector<float>({2}));
}

/// What a framer with this one message counts.
Drop reason_of(Bytes bytes) {
  sign(bytes);
  MessageFramer framer;
  Drop reason = Drop::none;
  framer.feed({bytes.data(), bytes.size()}, [&](const Message& message) {
    Transform transform;
    Sensor sensor;
    Ndarray array;
    ByteView text;
    reason = decode_transform(message, transform);
    if (reason == Drop::wrong_type) reason = decode_sensor(message, sensor);
    if (reason == Drop::wrong_type) reason = decode_ndarray_float64(message, array);
    if (reason == Drop::bad_scalar) reason = decode_ndarray_uint8(message, text);
  });
  for (std::size_t i = 0; i < drop_reasons; ++i)
    if (framer.counters().dropped[i]) reason = Drop(i);
  return reason;
}

void test_hostile_bodies() {
  const auto changed = [](Bytes bytes, std::size_t at, std::uint8_t value) {
    bytes.at(at) = value;
    return bytes;
  };
  const Bytes two = transform_message(1, 2);  // 58: extended header 12, content 48, metadata 2
  CHECK(reason_of(two) == Drop::none);
  CHECK(reason_of(changed(two, 59, 11)) == Drop::bad_extended_header);
  CHECK(reason_of(changed(two, 58, 255)) == Drop::bad_extended_header);
  CHECK(reason_of(changed(two, 60, 255)) == Drop::bad_extended_header);
  CHECK(reason_of(changed(two, 62, 255)) == Drop::bad_extended_header);
  CHECK(reason_of(changed(two, 119, 1)) == Drop::bad_metadata);
  CHECK(reason_of(changed(two, 61, 1)) == Drop::bad_metadata);  // less than a count
  CHECK(reason_of(changed(two, 59, 13)) == Drop::bad_length);   // content one byte short

  const std::vector<MetadataEntry> metadata{{"key", "value"}};
  Bytes bytes;
  encode_transform(bytes, {"burr", 0, 2, 1, &metadata}, {});
  CHECK(reason_of(bytes) == Drop::none);
  CHECK(reason_of(changed(bytes, 121, 2)) == Drop::none);  // a byte to spare
  CHECK(reason_of(changed(bytes, 121, 4)) == Drop::bad_metadata);
  CHECK(reason_of(changed(bytes, 124, 255)) == Drop::bad_metadata);

  CHECK(reason_of(changed(changed(transform_message(1), 94, 0x7F), 95, 0xC0)) == Drop::not_finite);
  const double values[] = {1, 2};
  Bytes sensor;
  encode_sensor(sensor, {"force"}, values, 2);
  CHECK(reason_of(changed(sensor, 58, 3)) == Drop::bad_length);
  CHECK(reason_of(changed(changed(sensor, 68, 0x7F), 69, 0xF0)) == Drop::not_finite);
  Bytes array;
  encode_ndarray_float64(array, {"tick"}, values, 2);
  CHECK(reason_of(changed(array, 61, 3)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 59, 0)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 59, 255)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 58, 10)) == Drop::bad_scalar);
  Bytes wrapped;  // 2^75 elements, which are 0 in 64 bits
  const std::uint16_t none[] = {32768, 32768, 32768, 32768, 0};
  encode_ndarray_float64(wrapped, {"tick"}, values, 0, none, 5);
  CHECK(reason_of(wrapped) == Drop::none);
  CHECK(reason_of(changed(wrapped, 68, 0x80)) == Drop::bad_length);
  Bytes text;
  encode_ndarray_uint8(text, {"digest"}, {sensor.data(), 5});
  CHECK(reason_of(changed(text, 69, 6)) == Drop::bad_length);
  CHECK(reason_of(changed(text, 62, 255)) == Drop::bad_length);
}

/// A stream at 1 kHz asks for memory once.
void test_no_allocation() {
  Bytes bytes;
  MessageFramer framer;
  int poses = 0;
  const MessageFramer::Receive receive = [&](const Message& message) {
    Transform transform;
    ByteView text;
    poses += decode_transform(message, transform) == Drop::none;
    poses += decode_ndarray_uint8(message, text) == Drop::none;
  };
  const double values[40] = {};
  const std::uint8_t text[32] = {};
  long before = 0;
  for (int i = 0; i < 100; ++i) {
    if (i == 1) before = allocations;
    bytes.clear();
    for (const int version : {1, 2}) {
      const Envelope envelope{"a device of 20 bytes", 0, version};
      encode_transform(bytes, envelope, {});
      encode_sensor(bytes, envelope, values, 3);
      encode_ndarray_float64(bytes, envelope, values, 40);
      encode_ndarray_uint8(bytes, envelope, {text, sizeof text});
    }
    framer.feed({bytes.data(), bytes.size()}, receive);
  }
  CHECK(allocations == before && poses == 400);
}

void test_bone_frame() {
  const Transform transform = to_ras({1.5, -2.25, 0.1});
  CHECK(transform.position[0] == -1.5f && transform.position[1] == 2.25f && transform.position[2] == 0.1f);
  CHECK(position_from_ras(transform) == burrlab::Vec3(1.5, -2.25, double(0.1f)));
  CHECK(!std::signbit(to_ras({0, 0, 0}).position[0]));
  CHECK(is_plausible({1e6, 0, 0}) && !is_plausible({0, 1.1e6, 0}));
  CHECK_THROWS(MessageFramer(47), "largest_body must be at least 48 bytes, got 47");
  CHECK_THROWS(MessageFramer(std::size_t(1) << 32), "largest_body must be below 4 GiB, got 4294967296");
}

}  // namespace

int main() {
  test_checksum();
  test_transform_bytes();
  test_round_trips();
  test_byte_strings();
  test_refusals();
  test_framer();
  test_lost_framing();
  test_hostile_bodies();
  test_no_allocation();
  test_bone_frame();
  return check::report();
}
