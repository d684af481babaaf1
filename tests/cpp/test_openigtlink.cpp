// OpenIGTLink messages: checksum, bytes written by hand, long byte strings, refusals.
#include "burrlab/network/openigtlink.hpp"

#include <cstring>
#include <limits>

#include "burrlab/network/bone_frame.hpp"
#include "check.hpp"

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
  const std::string long_key(65536, 'k');
  const std::vector<MetadataEntry> long_metadata{{long_key, ""}}, many(8192);
  CHECK_THROWS(encode_transform(bytes, {std::string_view("a\0b", 3), 0}, transform),
               "device_name must hold no zero byte, got one after 'a'");
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 2, 0, &long_metadata}, transform),
               "length of a metadata key must be at most 65535, got 65536");
  CHECK_THROWS(encode_transform(bytes, {"x", 0, 2, 0, &many}, transform),
               "number of metadata entries must be at most 8191, got 8192");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS(encode_sensor(bytes, {"x"}, &nan, 1), "every value must be finite, got nan");
  transform.rotation[8] = std::numeric_limits<float>::quiet_NaN();
  CHECK_THROWS(encode_transform(bytes, {"x"}, transform), "every number of rotation must be finite, got nan");
  const std::uint16_t shape[] = {2, 3};
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 5, shape, 2),
               "product of shape must be the number of values, got 5");
  CHECK_THROWS(encode_ndarray_float64(bytes, {"x"}, values, 65536),
               "number of values in one dimension must be at most 65535, got 65536");
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
  test_byte_strings();
  test_refusals();
  test_bone_frame();
  return check::report();
}
