// The only way out of the loop: a ring of tick records. One thread writes and never waits; any number read.
//
//     burrlab::RecordReader reader(loop.ring());
//     burrlab::TickRecord record;
//     while (reader.next(record) == burrlab::RecordReader::Result::record) draw(record.burr[0].center);
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "burrlab/error.hpp"
#include "burrlab/session/tick_record.hpp"

namespace burrlab {

/// Keeps the last `capacity` records. A reader that falls further behind can tell.
class BURRLAB_API RecordRing {
 public:
  /// Of records; throws InvalidArgument below 2.
  explicit RecordRing(std::size_t capacity);

  void push(const TickRecord& record) noexcept;  ///< one thread only

  std::uint64_t count() const { return count_.load(std::memory_order_acquire); }  ///< records pushed
  std::size_t capacity() const { return slots_.size(); }                          ///< records kept
  /// Record `number`, counted from 0; false if it is not there yet, or no longer.
  bool read(std::uint64_t number, TickRecord& record) const noexcept;

 private:
  static constexpr std::size_t words = sizeof(TickRecord) / 8;
  struct Slot {
    std::atomic<std::uint64_t> holds{0};  // number of the record + 1; 0 while it is written
    std::atomic<std::uint64_t> word[words];
  };
  std::vector<Slot> slots_;
  std::atomic<std::uint64_t> count_{0};
};

/// One reader's place in a ring, for one thread.
class RecordReader {
 public:
  /// What `next` found.
  enum class Result {
    record,  ///< a record
    none,    ///< none yet
    lost     ///< the record was overwritten
  };

  /// Begins with record `from`.
  explicit RecordReader(std::shared_ptr<const RecordRing> ring, std::uint64_t from = 0)
      : ring_(std::move(ring)), next_(from) {}

  /// Reads the next record. When it is lost, call `skip_to`.
  Result next(TickRecord& record) {
    const std::uint64_t number = position();
    if (number >= ring_->count()) return Result::none;
    if (!ring_->read(number, record)) return Result::lost;
    skip_to(number + 1);
    return Result::record;
  }
  /// The next record is this one.
  void skip_to(std::uint64_t number) { next_.store(number, std::memory_order_release); }
  /// Number of the next record.
  std::uint64_t position() const { return next_.load(std::memory_order_acquire); }
  std::uint64_t behind() const { return ring_->count() - position(); }  ///< records not yet read

 private:
  std::shared_ptr<const RecordRing> ring_;
  std::atomic<std::uint64_t> next_;
};

}  // namespace burrlab
