// Bones and recorded sessions in a flat file, byte by byte in docs/trace_format.md. Python reads them, and
// `burrlab export` writes bones.
//
//   std::uint64_t tick = 0;
//   auto bone = std::make_shared<burrlab::VoxelBone>(burrlab::read_bone("bone.burr", &tick));
//   auto executor = std::make_shared<burrlab::TickExecutor>(bone, setup, tick);
//   burrlab::HapticLoop loop(executor, devices, settings);
//   burrlab::FlatTrace("session.burr", executor).record(loop);
#pragma once

#include <filesystem>
#include <fstream>

#include "burrlab/session/haptic_loop.hpp"

namespace burrlab {

/// Writes a bone to a new file. `tick`: ticks executed on it; `source`: where it comes from. Throws
/// InvalidArgument if another thread changes the bone, SystemError if the file exists or cannot be written.
BURRLAB_API void write_bone(const std::filesystem::path& path, const VoxelBone& bone, std::uint64_t tick = 0,
                            const std::string& source = "");
/// The bone that was written, or with which a trace begins. Throws InvalidArgument, a sentence with the
/// path, if the file is no flat file, damaged, or of a newer format, and SystemError if it cannot be read.
BURRLAB_API VoxelBone read_bone(const std::filesystem::path& path, std::uint64_t* tick = nullptr,
                                std::string* source = nullptr);

/// Writes a session to a new file. One thread at a time, not the haptic one: it allocates, and waits for the
/// disk. Every call throws SystemError if the system cannot write the file.
class BURRLAB_API FlatTrace {
 public:
  /// Writes the executor's bone as it is, and its setup; to be made before the next tick. Throws SystemError
  /// if the file exists.
  FlatTrace(const std::filesystem::path& path, std::shared_ptr<const TickExecutor> executor,
            const std::string& source = "");

  /// Of a host that calls TickExecutor::execute: writes the tick executed last. Ticks reach the file some 40
  /// at a time. Throws InvalidArgument, and writes nothing, if the tick is not the next one.
  void write(const TickRecord& record);
  /// Starts the loop if it has not been, writes its ticks every 20 ms until it ends, and finishes. A virtual
  /// clock that is started here waits for the file. If a tick was lost, as the ring was overrun, the file
  /// says so and RuntimeError is thrown. After an error the loop goes on.
  void record(HapticLoop& loop);
  /// Ends the file with the reason, cut to 151 bytes, and the bone's digest; later calls do nothing. Throws
  /// InvalidArgument if the bone is in use. A file without this is that of a killed program.
  void finish(const std::string& reason) { end(executor_->bone()->digest(), reason); }

 private:
  void end(const std::string& digest, const std::string& reason);

  std::filesystem::path path_;
  std::shared_ptr<const TickExecutor> executor_;
  std::ofstream file_;
  std::uint64_t next_;          // tick
  std::uint32_t checksum_ = 1;  // of the ticks in the file
};

}  // namespace burrlab
