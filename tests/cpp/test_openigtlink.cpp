// OpenIGTLink messages: checksum, bytes written by hand, long byte strings, refusals.
#include "network/openigtlink.hpp"

#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>

#include "check.hpp"
#include "network/bone_frame.hpp"

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
  const char* digits = "123456789";  // with the check value of ECMA-182 in catalogues of checksums
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

/// The bytes of each message are those of tests/golden/frozen/messages.json.
void test_frozen_bytes() {
  std::ifstream file(FROZEN_MESSAGES);
  const std::string frozen{std::istreambuf_iterator<char>(file), {}};
  const double force[] = {0.1, 3.141592653589793, -3e300}, ticks[] = {0, 1, 2, 3, 4, 5};
  const std::uint16_t shape[] = {2, 3};
  const std::uint8_t text[] = {'0', '1', '2', '3'};
  Transform transform;
  transform.rotation = {0, -1, 0, 1, 0, 0, 0, 0, 1};
  transform.position = {1.5f, -2.5f, 0.1f};
  for (const int version : {1, 2}) {
    const auto envelope = [&](const char* name) {
      return Envelope{name, timestamp_of(1750000000, 0), version};
    };
    Bytes bytes[4];
    encode_transform(bytes[0], envelope("burr"), transform);
    encode_sensor(bytes[1], envelope("force"), force, 3);
    encode_ndarray_float64(bytes[2], envelope("tick"), ticks, 6, shape, 2);
    encode_ndarray_uint8(bytes[3], envelope("digest"), {text, 4});
    const char* names[] = {"TRANSFORM", "SENSOR", "NDARRAY 64", "NDARRAY 8"};
    for (int i = 0; i < 4; ++i) {
      std::string line = "\"" + std::string(names[i]) + " " + std::to_string(version) + "\": \"";
      for (const std::uint8_t byte : bytes[i]) {
        line += "0123456789abcdef"[byte / 16];
        line += "0123456789abcdef"[byte % 16];
      }
      CHECK(frozen.find(line + "\"") != std::string::npos);
    }
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
    std::vector<double> values;
    CHECK(decode_ndarray_float64(message, values) == Drop::bad_scalar);
  }
}

void test_refusals() {
  Bytes bytes{1, 2, 3};
  Transform transform;
  const double values[256] = {};
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 3}, transform), "version must be 1 or 2, got 3");
  CHECK_THROWS(encode_transform(bytes, {"a name of over 20 bytes"}, transform),
               "length of device_name must be at most 20, got 23");
  CHECK_THROWS(encode_sensor(bytes, {"x"}, values, 256), "number of values must be at most 255, got 256");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS(encode_sensor(bytes, {"x"}, &nan, 1), "every value must be finite, got nan");
  transform.rotation[8] = std::numeric_limits<float>::quiet_NaN();
  CHECK_THROWS(encode_transform(bytes, {"x"}, transform), "every number of rotation must be finite, got nan");
  const std::uint16_t shape[] = {2, 3};
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 5, shape, 2),
               "product of shape must be the number of values, got 5");
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 1, shape, 0),
               "number of dimensions must be 1 to 255, got 0");
  CHECK_THROWS(encode_ndarray_uint8(bytes, {"x"}, {nullptr, longest_byte_string + 1}),
               "length of bytes must be at most 4294836217, got 4294836218");
  CHECK(bytes == Bytes({1, 2, 3}));
}

void test_bone_frame() {
  const Transform transform = to_ras({1.5, -2.25, 0.1});
  CHECK(transform.position[0] == -1.5f && transform.position[1] == 2.25f && transform.position[2] == 0.1f);
  CHECK(position_from_ras(transform) == burrlab::Vec3(1.5, -2.25, double(0.1f)));
  CHECK(!std::signbit(to_ras({0, 0, 0}).position[0]));
  CHECK(is_plausible({1e6, 0, 0}) && !is_plausible({0, 1.1e6, 0}));
}

}  // namespace

int main() {
  test_checksum();
  test_transform_bytes();
  test_frozen_bytes();
  test_byte_strings();
  test_refusals();
  test_bone_frame();
  return check::report();
}
