// Records pass whole and in order from one writer to many readers, and neither waits; also the other cells
// and counts that threads share.
#include "burrlab/session/record_ring.hpp"

#include <cmath>
#include <thread>

#include "burrlab/session/histogram.hpp"
#include "check.hpp"
#include "session/latest.hpp"

using namespace burrlab;

namespace {

/// A record whose every part holds its number.
TickRecord numbered(std::uint64_t n) {
  TickRecord record;
  record.index = n;
  for (BurrRecord& burr : record.burr) {
    burr.center = {double(n), double(n) + 1.0, double(n) + 2.0};
    burr.removed = std::int64_t(n);
    burr.age = double(n);
  }
  return record;
}

bool is_whole(const TickRecord& record) {
  const auto n = double(record.index);
  for (const BurrRecord& burr : record.burr)
    if (burr.center[0] != n || burr.center[2] != n + 2.0 || burr.removed != std::int64_t(n) || burr.age != n)
      return false;
  return true;
}

void in_order() {
  auto ring = std::make_shared<RecordRing>(8);
  RecordReader reader(ring);
  TickRecord record;
  CHECK(reader.next(record) == RecordReader::Result::none);
  for (std::uint64_t n = 0; n < 8; ++n) ring->push(numbered(n));
  for (std::uint64_t n = 0; n < 8; ++n)
    CHECK(reader.next(record) == RecordReader::Result::record && record.index == n && is_whole(record));
  CHECK(reader.next(record) == RecordReader::Result::none);
  for (std::uint64_t n = 8; n < 17; ++n) ring->push(numbered(n));
  CHECK(reader.behind() == 9);
  CHECK(reader.next(record) == RecordReader::Result::lost);  // 16 overwrote 8
  reader.skip_to(9);
  CHECK(reader.next(record) == RecordReader::Result::record && record.index == 9);
  CHECK(!ring->read(~std::uint64_t{0}, record));
  CHECK_THROWS(RecordRing(1), "capacity must be at least 2, got 1");
}

/// Two readers beside a writer that laps them: every record is whole, and numbers only rise.
void beside_a_writer() {
  auto ring = std::make_shared<RecordRing>(64);
  constexpr std::uint64_t total = 400000;
  std::atomic<bool> ok{true};
  std::atomic<std::uint64_t> seen{0};
  const auto read = [&] {
    RecordReader reader(ring);
    TickRecord record;
    std::uint64_t next = 0;
    while (next < total) {
      switch (reader.next(record)) {
        case RecordReader::Result::record:
          if (record.index < next || !is_whole(record)) ok = false;
          next = record.index + 1;
          ++seen;
          break;
        case RecordReader::Result::lost:
          reader.skip_to(ring->count() > 32 ? ring->count() - 32 : 0);
          break;
        case RecordReader::Result::none:
          std::this_thread::yield();
      }
    }
  };
  std::thread one(read), other(read);
  for (std::uint64_t n = 0; n < total; ++n) ring->push(numbered(n));
  one.join();
  other.join();
  CHECK(ok);
  CHECK(seen > 0);
}

void latest_is_whole() {
  struct Pair {
    std::uint64_t a, b;
  };
  Latest<Pair> cell;
  std::atomic<bool> done{false}, ok{true};
  std::thread reader([&] {
    Pair pair{};
    while (!done)
      if (cell.get(pair) && pair.b != 3 * pair.a) ok = false;
  });
  for (std::uint64_t n = 0; n < 300000; ++n) cell.put({n, 3 * n});
  done = true;
  reader.join();
  Pair last{};
  CHECK(ok && cell.get(last) && last.a == 299999);
}

void histogram() {
  Histogram h;
  CHECK(std::isnan(h.quantile(0.5)) && h.count() == 0);
  for (int i = 1; i <= 1000; ++i) h.add(i);
  CHECK(h.count() == 1000 && h.largest() == 1000.0);
  for (const double p : {0.1, 0.5, 0.9, 0.99}) {
    CHECK(h.quantile(p) >= 1000 * p - 1e-9);
    CHECK(h.quantile(p) <= 1000 * p * 1.04 + 1.0);
  }
  CHECK(h.quantile(1.0) == 1000.0);
  h.add(1e12), h.add(-1.0), h.add(std::nan("")), h.add(INFINITY);
  CHECK(h.count() == 1004 && h.counts().back() == 2 && h.counts().front() == 2);
  const auto edges = Histogram::edges();
  for (std::size_t i = 1; i < edges.size(); ++i) CHECK(edges[i] > edges[i - 1]);
  for (const double value : {0.07, 1.0, 3.3, 40.0, 999.0, 1e5}) {  // each is in the bin of its edges
    Histogram one;
    one.add(value);
    const auto counts = one.counts();
    for (std::size_t i = 0; i < counts.size(); ++i)
      if (counts[i]) CHECK(edges[i] <= value && value < edges[i + 1]);
  }
}

}  // namespace

int main() {
  in_order();
  beside_a_writer();
  latest_is_whole();
  histogram();
  return check::report();
}
