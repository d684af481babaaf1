// The framer: whole messages from any pieces, dropped messages by reason, and one allocation per stream.
#include "network/message_framer.hpp"

#include <algorithm>

#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab::openigtlink;

namespace {

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

void sign(Bytes& bytes) {  // sets the checksum of a changed body
  const std::uint64_t crc = crc64({bytes.data() + header_size, bytes.size() - header_size});
  for (int i = 0; i < 8; ++i) bytes[50 + i] = std::uint8_t(crc >> (56 - 8 * i));
}

/// Feeds `stream` in pieces; returns the x of the TRANSFORMs.
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
  Bytes image = transform_message(2, 1, "IMAGE");  // skipped at any size
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
  MessageFramer framer;  // bytes missing in a body: a wrong checksum, then no header
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

/// The reason a framer counts for this one message.
Drop reason_of(Bytes bytes) {
  sign(bytes);
  MessageFramer framer;
  Drop reason = Drop::none;
  framer.feed({bytes.data(), bytes.size()}, [&](const Message& message) {
    Transform transform;
    std::vector<double> values;
    ByteView text;
    reason = decode_transform(message, transform);
    if (reason == Drop::wrong_type) reason = decode_ndarray_float64(message, values);
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
  CHECK(reason_of(changed(two, 59, 13)) == Drop::bad_length);  // content one byte short

  Bytes metadata = two;  // of 10 bytes for lengths and 8 for "key" and "value"; it is passed over
  metadata[61] = 10;
  metadata[65] = 8;
  metadata.resize(metadata.size() + 16);
  set_body_size(metadata, 78);
  CHECK(reason_of(metadata) == Drop::none);
  CHECK(reason_of(changed(metadata, 65, 9)) == Drop::bad_length);  // taken from the content
  CHECK(reason_of(changed(metadata, 65, 70)) == Drop::bad_extended_header);

  CHECK(reason_of(changed(changed(transform_message(1), 94, 0x7F), 95, 0xC0)) == Drop::not_finite);
  const double values[] = {1, 2};
  const std::uint16_t two_values = 2;
  Bytes array;
  encode_ndarray_float64(array, {"tick"}, values, 2, &two_values, 1);
  CHECK(reason_of(changed(array, 61, 3)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 59, 0)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 59, 255)) == Drop::bad_length);
  CHECK(reason_of(changed(array, 58, 10)) == Drop::bad_scalar);
  Bytes wrapped;  // 2^75 elements, which is 0 in 64 bits
  const std::uint16_t none[] = {32768, 32768, 32768, 32768, 0};
  encode_ndarray_float64(wrapped, {"tick"}, values, 0, none, 5);
  CHECK(reason_of(wrapped) == Drop::none);
  CHECK(reason_of(changed(wrapped, 68, 0x80)) == Drop::bad_length);
  Bytes text;
  encode_ndarray_uint8(text, {"digest"}, {array.data(), 5});
  CHECK(reason_of(changed(text, 69, 6)) == Drop::bad_length);
  CHECK(reason_of(changed(text, 62, 255)) == Drop::bad_length);
}

/// A stream at 1 kHz allocates once.
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
  const std::uint16_t count = 40;
  const std::uint8_t text[32] = {};
  long before = 0;
  for (int i = 0; i < 100; ++i) {
    if (i == 1) before = allocations;
    bytes.clear();
    for (const int version : {1, 2}) {
      const Envelope envelope{"a device of 20 bytes", 0, version};
      encode_transform(bytes, envelope, {});
      encode_sensor(bytes, envelope, values, 3);
      encode_ndarray_float64(bytes, envelope, values, 40, &count, 1);
      encode_ndarray_uint8(bytes, envelope, {text, sizeof text});
    }
    framer.feed({bytes.data(), bytes.size()}, receive);
  }
  CHECK(allocations == before && poses == 400);
}

}  // namespace

int main() {
  test_framer();
  test_lost_framing();
  test_hostile_bodies();
  test_no_allocation();
  return check::report();
}
