#include "burrlab/flat_file.hpp"

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <iomanip>
#include <sstream>

#include "brick_levels.hpp"
#include "burrlab.h"
#include "cpu_path.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {
namespace {

using Levels = VoxelBone::Levels;
using Path = std::filesystem::path;

constexpr char magic[] = "burrlab flat file 1 ";
constexpr std::size_t end_size = 184;  // of the digest and the reason [bytes]

/// Adler-32 of bytes that follow those of `before`, as in zlib.
std::uint32_t checksum(const char* bytes, std::size_t size, std::uint32_t before = 1) {
  std::uint32_t sum = before & 0xffff, sums = before >> 16;
  for (std::size_t i = 0; i < size; ++i) {
    sum = (sum + std::uint8_t(bytes[i])) % 65521;
    sums = (sums + sum) % 65521;
  }
  return sums << 16 | sum;
}

void require_good(const std::ios& file, const Path& path) {
  if (!file) throw SystemError({errno ? errno : EIO, std::generic_category()}, path.string());
}

template <class... Words>
void put(std::ostream& head, const Words&... words) {
  ((head << words << ' '), ...);
}

void put_material(std::ostream& head, const Material& m) {
  put(head, std::quoted(m.name), std::quoted(m.source), std::quoted(m.shape.name()), m.c_e, m.alpha,
      m.force_exponent, m.rate_exponent);
}

/// A new file up to its ticks; without `setup`, of a bone alone.
std::ofstream create(const Path& path, const VoxelBone& bone, std::uint64_t tick, const std::string& source,
                     const SessionSetup* setup = nullptr) {
  std::error_code code;
  const auto status = std::filesystem::status(path, code);
  if (std::filesystem::exists(status)) code = std::make_error_code(std::errc::file_exists);
  if (status.type() != std::filesystem::file_type::not_found) throw SystemError(code, path.string());
  const StandardEnvironment environment;
  const VoxelBone::Reading reading(bone);
  const TissueMap* map = bone.tissues().get();
  std::vector<const std::uint8_t*> eroded(bone.brick_count());
  for (std::size_t brick = 0; brick < eroded.size(); ++brick)
    if (bone.is_eroded(brick)) eroded[brick] = bone.tile(brick);
  const Levels parts[] = {bone.packed(), pack(Levels(eroded.size()), eroded), map ? map->packed() : Levels()};
  std::ostringstream head;
  head.imbue(std::locale::classic());
  head.precision(17);
  for (const std::int64_t n : bone.shape()) put(head, n);
  for (const Vec3* v : {&bone.spacing(), &bone.origin()}) put(head, v->x(), v->y(), v->z());
  put(head, tick, bone.digest(), std::quoted(source), parts[0].size(), parts[1].size(), parts[2].size());
  put(head, map ? map->table().size() : 0);
  if (map) {
    put_material(head, map->table().material());
    for (const Tissue& t : map->table().all())
      put(head, std::quoted(t.name), t.label, t.c_e, t.alpha, int(t.colour[0]), int(t.colour[1]),
          int(t.colour[2]), t.critical, t.bleeds, t.assumed);
  }
  if (setup) {
    const std::chrono::duration<double> now = std::chrono::system_clock::now().time_since_epoch();
    put(head, setup->seed, setup->period, setup->scheme == Scheme::layer ? "layer" : "cell", now.count(),
        cpu_path(), burrlab_version(), setup->tools.size());
    for (const Tool& tool : setup->tools) put_material(head << tool.burr.radius << ' ', tool.material);
  }
  const std::string text = head.str();
  std::ofstream file(path, std::ios::binary);
  file.imbue(std::locale::classic());
  file << magic << text.size() << ' ' << checksum(text.data(), text.size()) << '\n' << text;
  for (const Levels& part : parts)
    file.write(reinterpret_cast<const char*>(part.data()), std::streamsize(part.size()));
  if (file.flush()) return file;
  const int reason = errno;
  std::error_code ignored;
  file.close();
  std::filesystem::remove(path, ignored);  // a part would stand in the way of the next try
  errno = reason;
  require_good(file, path);
  return file;
}

VoxelBone read_content(std::ifstream& file, std::uint64_t left, std::uint64_t& tick, std::string& source) {
  const StandardEnvironment environment;
  const auto get_bytes = [&](auto bytes, std::uint64_t count) {
    bytes.resize(std::size_t(std::min(count, left)));
    file.read(reinterpret_cast<char*>(bytes.data()), std::streamsize(bytes.size()));
    if (!file || count > left) throw InvalidArgument("it was cut short");
    return bytes;
  };
  std::uint64_t size = 0, sizes[3] = {};
  std::uint32_t sum = 0;
  file >> size >> sum;
  file.get();
  const std::string text = get_bytes(std::string(), size);
  if (checksum(text.data(), text.size()) != sum) throw InvalidArgument("its header was changed");
  std::istringstream head(text);
  head.imbue(std::locale::classic());
  Index3 shape{};
  Vec3 spacing, origin;
  std::string digest;
  std::size_t tissues = 0;
  for (std::int64_t& n : shape) head >> n;
  for (Vec3* v : {&spacing, &origin}) head >> v->x() >> v->y() >> v->z();
  head >> tick >> digest >> std::quoted(source) >> sizes[0] >> sizes[1] >> sizes[2] >> tissues;
  const Levels pristine = get_bytes(Levels(), sizes[0]), present = get_bytes(Levels(), sizes[1]);
  double bricks = 1.0;
  for (const std::int64_t n : shape) bricks *= std::ceil(double(n) / brick_side);
  if (2.0 * bricks > double(pristine.size()))  // before the bone takes memory for its shape
    throw InvalidArgument("its levels do not fill its shape");
  VoxelBone bone(shape, pristine.data(), pristine.size(), spacing, origin);
  const auto eroded = packed_tiles(present.data(), present.size(), bone.brick_count());
  std::uint8_t q[brick_voxels], p[brick_voxels];
  for (std::size_t brick = 0; brick < eroded.size(); ++brick) {
    bone.read_brick(brick, q, p);
    bone.write_brick(brick, eroded[brick] ? eroded[brick] : q, p);  // throws for levels beyond the volume
  }
  if (tissues) {
    const Levels numbers = get_bytes(Levels(), sizes[2]);
    Material m("", 1.0, 0.0, Shape::parabolic(), "");
    std::string shape_name;
    head >> std::quoted(m.name) >> std::quoted(m.source) >> std::quoted(shape_name) >> m.c_e >> m.alpha;
    head >> m.force_exponent >> m.rate_exponent;
    std::vector<Tissue> table;
    while (head && table.size() < tissues) {
      Tissue& t = table.emplace_back();
      int colour[3] = {};
      head >> std::quoted(t.name) >> t.label >> t.c_e >> t.alpha >> colour[0] >> colour[1] >> colour[2];
      head >> t.critical >> t.bleeds >> t.assumed;
      for (int i = 0; i < 3; ++i) t.colour[i] = std::uint8_t(colour[i]);
    }
    const Tissues all(table, Material(m.name, m.c_e, m.alpha, Shape::parse(shape_name), m.source,
                                      m.force_exponent, m.rate_exponent));
    bone.set_tissues(std::make_shared<const TissueMap>(shape, numbers.data(), numbers.size(), all));
  }
  if (bone.digest() != digest)
    throw InvalidArgument("the bone has digest " + bone.digest() + ", and was written with " + digest);
  return bone;
}

}  // namespace

void write_bone(const Path& path, const VoxelBone& bone, std::uint64_t tick, const std::string& source) {
  create(path, bone, tick, source);
}

VoxelBone read_bone(const Path& path, std::uint64_t* tick, std::string* source) {
  std::error_code code;
  const std::uint64_t size = std::filesystem::file_size(path, code);
  if (code) throw SystemError(code, path.string());
  std::ifstream file(path, std::ios::binary);
  require_good(file, path);
  file.imbue(std::locale::classic());
  std::string start(sizeof magic - 1, '\0'), from;
  file.read(start.data(), std::streamsize(start.size()));
  if (start != magic)
    throw InvalidArgument(path.string() + " is not a flat file of format 1, the newest that is known");
  try {
    std::uint64_t executed = 0;
    VoxelBone bone = read_content(file, size, executed, from);
    if (tick) *tick = executed;
    if (source) *source = from;
    return bone;
  } catch (const std::invalid_argument& error) {
    throw InvalidArgument(path.string() + " is damaged: " + error.what());
  }
}

FlatTrace::FlatTrace(const Path& path, std::shared_ptr<const TickExecutor> executor,
                     const std::string& source)
    : path_(path),
      executor_(executor ? std::move(executor) : throw InvalidArgument("executor must not be null")),
      next_(executor_->tick()) {
  const std::uint16_t number = 1;
  if (!*reinterpret_cast<const char*>(&number))
    throw InvalidArgument("a flat file of a session needs a little-endian machine");
  file_ = create(path, *executor_->bone(), next_, source, &executor_->setup());
}

void FlatTrace::write(const TickRecord& record) {
  check_record(record, executor_->burrs());
  if (!file_.is_open()) throw InvalidArgument("trace must not be finished");
  if (record.index != next_)
    refuse("index of a tick", "the next one, " + std::to_string(next_), double(record.index));
  const auto* row = reinterpret_cast<const char*>(&record);
  const std::size_t size = offsetof(TickRecord, burr) + record.burrs * sizeof(BurrRecord);
  require_good(file_.write(row, std::streamsize(size)), path_);
  checksum_ = checksum(row, size, checksum_);
  ++next_;
}

void FlatTrace::record(HapticLoop& loop) {
  if (loop.executor() != executor_) throw InvalidArgument("loop must have the executor of the trace");
  const auto reader = std::make_shared<RecordReader>(loop.ring());
  if (!loop.started()) {
    loop.add_reader(reader);
    loop.start();
  }
  TickRecord record;
  for (bool ended = false; !ended;) {
    ended = loop.wait(0.02);
    auto next = reader->next(record);
    for (; next == RecordReader::Result::record; next = reader->next(record)) write(record);
    require_good(file_.flush(), path_);
    if (next == RecordReader::Result::none) continue;
    const std::string why = "the record of tick " + std::to_string(next_) + " was lost: the ring was overrun";
    end("-", why);
    throw RuntimeError(path_.string() + ": " + why);
  }
  finish(loop.reason());
}

void FlatTrace::end(const std::string& digest, const std::string& reason) {
  if (!file_.is_open()) return;
  std::string text = digest + ' ' + reason;
  text.resize(end_size, ' ');
  const std::uint32_t sum = checksum(text.data(), text.size(), checksum_);
  file_ << "\nend " << std::setw(10) << sum << ' ' << text;
  file_.close();
  require_good(file_, path_);
}

}  // namespace burrlab
