// Flat files: bones and sessions come back to the bit, damage is refused. With a path, writes the session of
// tests/golden/files/flat.burr there.
#include "burrlab/flat_file.hpp"

#include <cstddef>
#include <cstring>
#include <iterator>
#include <sstream>
#ifndef _WIN32
#include <sys/resource.h>

#include <csignal>
#endif

#include "loop_scenes.hpp"

using namespace burrlab;
using namespace scenes;

namespace {

const std::filesystem::path folder = std::filesystem::temp_directory_path() / "burrlab_test_flat_file";
const std::filesystem::path file = folder / "a.burr";

std::string content_of(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void put_content(const std::string& content) {
  std::filesystem::remove(file);  // to write over it would wait for the disk
  std::ofstream(file, std::ios::binary) << content;
}

/// 12 x 13 x 19 voxels of several levels, in two tissues.
std::shared_ptr<VoxelBone> some_bone() {
  const Index3 shape{12, 13, 19};
  VoxelBone::Levels levels(12 * 13 * 19), numbers(levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    levels[i] = std::uint8_t(i % 19 < 8 ? 255 : 37 * i % 256);
    numbers[i] = i % 19 > 9;
  }
  const auto bone =
      std::make_shared<VoxelBone>(shape, levels, Vec3(0.08, 0.09, 0.1), Vec3(-0.9, 1.0 / 3.0, 0.0));
  const Material wax("wax \"soft\"", 2.145, 0.087, Shape::parse("quartic"), "made\nup \\", 1.25, 0.5);
  Tissue hard{"hard", 3, 2.5, 0.1, {255, 0, 7}, true, false, true}, soft{"weich, \xc3\xbc", 8, 0.75, 0.3};
  bone->set_tissues(std::make_shared<const TissueMap>(shape, numbers.data(), Tissues({hard, soft}, wax)));
  return bone;
}

TickRecord tick_of(std::uint64_t index) {
  TickRecord record;
  record.index = index;
  record.k = index % 7 ? 1 : 3;
  record.burrs = 2;
  record.time = 0.001 * double(index);
  for (int i = 0; i < 2; ++i) {
    record.burr[i].center = {0.014 * double(index) - 0.9, 0.5 + 0.7 * i, 1.6 - 0.008 * double(index)};
    record.burr[i].on = index % 11 < 9;
    record.burr[i].buttons = std::uint8_t(index % 4);
  }
  return record;
}

std::shared_ptr<TickExecutor> two_burrs() {
  const auto bone = some_bone();
  const Material& wax = bone->tissues()->table().material();
  const SessionSetup setup{{{Burr(0.6), wax}, {Burr(0.4), wax}}, 18446744073709551557u, 0.5, Scheme::cell};
  const auto executor = std::make_shared<TickExecutor>(bone, setup, 20);
  for (std::uint64_t index = 20; index < 40; ++index) {
    TickRecord record = tick_of(index);
    executor->execute(record);
  }
  CHECK(bone->removed() > 0.0);
  return executor;
}

void write_session(const std::filesystem::path& path) {
  const auto executor = two_burrs();
  FlatTrace trace(path, executor, "a made up bone");
  for (std::uint64_t index = 40; index < 100; ++index) {
    TickRecord record = tick_of(index);
    executor->execute(record);
    trace.write(record);
  }
  trace.finish("the last stroke is done");
}

void bones() {
  const auto executor = two_burrs();
  const VoxelBone& bone = *executor->bone();
  write_bone(file, bone, 39, "a \"scan\"\n\\");
  std::uint64_t tick = 0;
  std::string source;
  const VoxelBone again = read_bone(file, &tick, &source);
  CHECK(again.digest() == bone.digest() && tick == 39 && source == "a \"scan\"\n\\");
  CHECK(again.pristine() == some_bone()->density() && again.density() == bone.density());
  CHECK(again.spacing() == bone.spacing() && again.origin() == bone.origin());
  CHECK(again.tissues()->table().material() == bone.tissues()->table().material());
  CHECK(again.removed_of(1) == bone.removed_of(1) && again.tissues()->table()[0].assumed);
}

/// Each file is refused in a sentence that names it, or holds the same bone.
void damage() {
  std::filesystem::remove(file);
  write_bone(file, *some_bone());
  const std::string whole = content_of(file), digest = some_bone()->digest();
  std::size_t refused = 0;
  const auto read_changed = [&](const std::string& content) {
    put_content(content);
    try {
      CHECK(read_bone(file).digest() == digest);
    } catch (const std::invalid_argument& error) {
      ++refused;
      CHECK(std::string(error.what()).rfind(file.string() + " is ", 0) == 0);
    }
  };
  for (std::size_t size = 0; size < whole.size(); ++size) read_changed(whole.substr(0, size));
  CHECK(refused == whole.size());
  for (std::size_t i = 0; i < whole.size(); ++i) {
    std::string changed = whole;
    changed[i] = char(changed[i] ^ (1 << i % 8));
    read_changed(changed);
  }
  CHECK(refused > 2 * whole.size() - 60);  // the rest are bytes that no level needs
  put_content("burrlab flat file 2" + whole.substr(19));
  CHECK_THROWS(read_bone(file), "a.burr is not a flat file of format 1, the newest that is known");
}

/// The words on the setup have a time, a CPU's path and a version, which may differ.
void golden() {
  std::filesystem::remove(file);
  write_session(file);
  const std::string now = content_of(file), before = content_of(GOLDEN_FLAT);
  const auto levels_of = [](const std::string& content) {
    const std::size_t line = content.find('\n') + 1;
    return line + std::stoul(content.substr(20));
  };
  CHECK(now.substr(levels_of(now)) == before.substr(levels_of(before)));
  std::istringstream words(now.substr(0, levels_of(now))), old(before.substr(0, levels_of(before)));
  int different = 0;
  for (std::string a, b; words >> a, old >> b;) different += a != b;
  CHECK(different <= 5);  // the header's size and checksum, and the version, too
  CHECK(read_bone(GOLDEN_FLAT).digest() == two_burrs()->bone()->digest());
}

/// Ticks of a loop, executed again from the file on its bone, give its forces and its last digest.
void loops() {
  std::filesystem::remove(file);
  LoopSettings settings = virtual_clock(3000);
  settings.ring = 0.3;
  Run run(settings);
  FlatTrace(file, run.loop->executor()).record(*run.loop);
  std::uint64_t first = 1;
  TickExecutor again(std::make_shared<VoxelBone>(read_bone(file, &first)), run.loop->executor()->setup());
  const std::string content = content_of(file), end = content.substr(content.size() - 200);
  const std::size_t size = offsetof(TickRecord, burr) + sizeof(BurrRecord);
  const char* row = content.data() + content.size() - 200 - 3000 * size;
  for (int i = 0; i < 3000; ++i, row += size) {
    TickRecord recorded;
    std::memcpy(static_cast<void*>(&recorded), row, size);
    TickRecord record = recorded;
    again.execute(record);
    CHECK(recorded.index == std::uint64_t(i) && record.burr[0].force == recorded.burr[0].force);
  }
  CHECK(first == 0 && end.substr(16, 32) == again.bone()->digest() && again.bone()->removed() > 0.0);
  CHECK(end.find(" all ticks were executed ") == 48);
}

/// An overrun ring ends the file with a reason, and without a digest.
void overrun() {
  std::filesystem::remove(file);
  LoopSettings settings = virtual_clock(1000);
  settings.ring = 0.3;
  Run run(settings);
  FlatTrace trace(file, run.loop->executor());
  run.to_end();
  std::string why;
  try {
    trace.record(*run.loop);
  } catch (const std::runtime_error& error) {
    why = error.what();
  }
  CHECK(why == file.string() + ": the record of tick 0 was lost: the ring was overrun");
  CHECK(content_of(file).find(" - the record of tick 0 was lost") != std::string::npos);
}

template <class Function>
void fails(Function&& function, std::errc code, const std::filesystem::path& path) {
  try {
    function();
  } catch (const std::system_error& error) {
    CHECK(error.code() == code && std::string(error.what()).find(path.string()) != std::string::npos);
    return;
  }
  CHECK(!"no std::system_error");
}

void refusals() {
  const auto executor = two_burrs();
  fails([&] { FlatTrace(file, executor); }, std::errc::file_exists, file);
  fails([&] { write_bone(file, *executor->bone()); }, std::errc::file_exists, file);
  const auto nowhere = folder / "nowhere" / "a.burr";
  fails([&] { FlatTrace(nowhere, executor); }, std::errc::no_such_file_or_directory, nowhere);
  fails([&] { write_bone(nowhere, *executor->bone()); }, std::errc::no_such_file_or_directory, nowhere);
  fails([&] { read_bone(nowhere); }, std::errc::no_such_file_or_directory, nowhere);
  const auto endless = folder / std::string(300, 'a');
  fails([&] { write_bone(endless, *executor->bone()); }, std::errc::filename_too_long, endless);
  FlatTrace over(folder / "over.burr", executor);
  over.finish("over");
  CHECK_THROWS(over.write(tick_of(40)), "trace must not be finished");
  std::filesystem::remove(file);
  FlatTrace trace(file, executor);
  const std::string before = content_of(file);
  CHECK_THROWS(trace.write(tick_of(41)), "index of a tick must be the next one, 40, got 41");
  Run run(virtual_clock(1));
  CHECK_THROWS(trace.record(*run.loop), "loop must have the executor of the trace");
#ifndef _WIN32
  rlimit limit{}, less{};
  getrlimit(RLIMIT_FSIZE, &limit);
  less = limit;
  less.rlim_cur = before.size() + 10000;
  std::signal(SIGXFSZ, SIG_IGN);
  setrlimit(RLIMIT_FSIZE, &less);
  fails(
      [&] {
        for (std::uint64_t index = 40; index < 100; ++index) trace.write(tick_of(index));
      },
      std::errc::file_too_large, file);
  setrlimit(RLIMIT_FSIZE, &limit);
  CHECK(content_of(file).size() <= before.size() + 10000 && read_bone(file).removed() > 0.0);
#endif
}

}  // namespace

int main(int count, char** words) {
  if (count > 1) return write_session(words[1]), 0;
  std::filesystem::remove_all(folder);
  std::filesystem::create_directory(folder);
  bones();
  damage();
  golden();
  loops();
  overrun();
  refusals();
  std::filesystem::remove_all(folder);
  return check::report();
}
