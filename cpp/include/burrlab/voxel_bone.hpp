// Bone on a regular grid: the level of each voxel now and as loaded.
//
//     const std::vector<std::uint8_t> levels(40 * 60 * 60, 255);  // (z, y, x): solid
//     burrlab::VoxelBone bone({40, 60, 60}, levels, {0.2, 0.2, 0.2}, {0.1, 0.1, 0.1});  // [mm]
//     const auto kept = bone.density();
//     bone.reset();               // as loaded
//     bone.restore(kept.data());  // as it was
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "burrlab/tissues.hpp"

namespace burrlab {

/// uint8 occupancy (z, y, x): 0 is empty, 255 solid bone. A voxel has two levels: `density` q, the present
/// one, and `pristine` p, as loaded or written; q <= p. The space outside the volume is empty.
class BURRLAB_API VoxelBone {
 public:
  using Levels = std::vector<std::uint8_t>;  ///< (z, y, x), x fastest

  /// Held by a thread while it uses a shared bone: one thread changes it, or any number read it. Nothing
  /// waits. BurrContact's ticks, HostBurr, HapticLoop, `restore`, `reset`, `set_tissues` and `digest` hold
  /// one themselves; callers of other members must hold one, unless their line says otherwise.
  template <bool changes>
  class Use {
   public:
    /// Throws InvalidArgument if another thread's use is in the way.
    explicit Use(const VoxelBone& bone) : count_(bone.users_.count) {
      int users = changes ? 0 : count_.load(std::memory_order_relaxed);
      do {
        if (users < 0 || (changes && users > 0)) refuse_use(users);
      } while (!count_.compare_exchange_weak(users, changes ? -1 : users + 1, std::memory_order_acquire));
    }
    ~Use() { changes ? count_.store(0, std::memory_order_release) : void(count_.fetch_sub(1)); }
    Use(const Use&) = delete;

   private:
    std::atomic<int>& count_;
  };
  using Changing = Use<true>;  ///< of the only thread that uses the bone
  using Reading = Use<false>;  ///< of a thread beside others that read

  /// shape (z, y, x); spacing (x, y, z) [mm]; origin: centre of voxel (0, 0, 0), (x, y, z) [mm]. Constructors
  /// throw InvalidArgument unless levels fill the shape, spacings are positive and all numbers finite.
  VoxelBone(const Index3& shape, const Levels& levels, const Vec3& spacing, const Vec3& origin);
  /// The same level in every voxel.
  VoxelBone(const Index3& shape, std::uint8_t level, const Vec3& spacing, const Vec3& origin);
  /// A bone with the levels that `packed` returned.
  VoxelBone(const Index3& shape, const std::uint8_t* packed, std::size_t size, const Vec3& spacing,
            const Vec3& origin);
  VoxelBone(const VoxelBone& other);  ///< with levels of its own; a map of tissues is shared
  VoxelBone(VoxelBone&&) = default;
  VoxelBone& operator=(VoxelBone&&) = default;
  VoxelBone& operator=(const VoxelBone& other) { return *this = VoxelBone(other); }

  const Index3& shape() const { return shape_; }    ///< voxels (z, y, x)
  const Vec3& spacing() const { return spacing_; }  ///< (x, y, z) [mm]
  const Vec3& origin() const { return origin_; }    ///< centre of voxel (0, 0, 0) [mm]
  double voxel_volume() const;                      ///< [mm^3]
  double volume_of(std::int64_t levels) const;      ///< solid bone of a sum of levels [mm^3]

  double mass() const;     ///< of solid bone left [mm^3]; any thread at any time
  double removed() const;  ///< pristine minus present [mm^3]; any thread at any time

  Levels density() const { return read({0, 0, 0}, shape_, false); }  ///< dense copy, (z, y, x)
  Levels pristine() const { return read({0, 0, 0}, shape_, true); }  ///< dense copy, (z, y, x)
  /// Copy of the box that begins at `start` (z, y, x); throws if the box leaves the volume.
  Levels read(const Index3& start, const Index3& shape, bool pristine) const;
  /// The same into `out`, which holds the box.
  void read(const Index3& start, const Index3& shape, bool pristine, std::uint8_t* out) const;

  Levels packed() const;  ///< pristine levels in few bytes, by `pack`

  /// Throws unless the box lies inside the volume.
  void check_box(const Index3& start, const Index3& shape) const;
  /// Sets q and p of the box that begins at `start` (z, y, x); throws if the box leaves the volume.
  void write(const Index3& start, const Index3& shape, const std::uint8_t* levels);
  /// Sets q of the whole volume, as from a snapshot; throws if a q is above its p.
  void restore(const std::uint8_t* density);
  void reset();  ///< q = p everywhere

  /// Gives each voxel's pristine content a tissue; null: one material. Copies of a bone share the map.
  void set_tissues(std::shared_ptr<const TissueMap> map);
  const std::shared_ptr<const TissueMap>& tissues() const { return tissues_; }  ///< null: one material
  double mass_of(std::size_t tissue) const { return volume_of(tissue_levels(tissue)); }  ///< present [mm^3]
  double removed_of(std::size_t tissue) const;  ///< pristine minus present [mm^3]
  /// Present levels of a tissue.
  std::int64_t tissue_levels(std::size_t tissue) const { return tissue_sums_.present[tissue]; }
  std::vector<std::int64_t> tissue_levels() const;  ///< of each tissue; empty without tissues

  /// 128 bits as 32 hexadecimal digits: geometry, plus the sum over 8^3 bricks of a hash of brick index, q, p
  /// and, with tissues, their numbers and table. In a sum, the part of a brick that changed can be replaced.
  std::string digest() const;

  /// Writes to every page, so that no tick is the first to do so.
  void write_pages();

  // Bricks by number, for copies of a bone that follow it.
  /// Bricks of 8^3 voxels.
  std::size_t brick_count() const { return sums_.size(); }
  /// (z, y, x) among bricks.
  Index3 place(std::size_t brick) const { return place_in(bricks_, std::int64_t(brick)); }
  /// Voxels (z, y, x) within the volume.
  Index3 extent(std::size_t brick) const { return extent(place(brick)); }
  /// Numbers of the bricks that the box between two points [mm] meets, in order.
  std::vector<std::uint32_t> bricks_between(const Vec3& low, const Vec3& high) const;
  /// Numbers of the bricks that lost bone or were written since the last call, in order.
  std::vector<std::uint32_t> take_changed();
  /// Whether present and pristine levels may differ.
  bool is_eroded(std::size_t brick) const { return state_[brick] & eroded; }
  /// Reads q and p of a brick, 512 levels each, zeros beyond the volume.
  void read_brick(std::size_t brick, std::uint8_t* density, std::uint8_t* pristine) const;
  /// Sets q and p of a brick; throws if a q is above its p, or a p beyond the volume is not zero.
  void write_brick(std::size_t brick, const std::uint8_t* density, const std::uint8_t* pristine);
  /// Copies the present levels of a brick from a bone with the same pristine levels. A tick in another thread
  /// may change them meanwhile; TickExecutor::version shows whether one did.
  void copy_brick(std::size_t brick, const VoxelBone& from);

  /// Bytes of the sums, states and occupancy beside the levels.
  std::size_t hierarchy_bytes() const;

  /// @cond tick
  // For the tick: bricks by number, (z, y, x) in C order.
  const Index3& bricks() const { return bricks_; }  ///< number of bricks (z, y, x)
  const Occupancy& occupancy() const { return occupancy_; }
  std::size_t brick_number(std::int64_t z, std::int64_t y, std::int64_t x) const {
    return number_in(bricks_, {z, y, x});
  }
  const BrickSums& sums(std::size_t brick) const { return sums_[brick]; }
  const std::uint8_t* tile(std::size_t brick) const { return density_.tile(brick); }
  /// Pristine levels of a brick; null if all are `pristine_level`.
  const std::uint8_t* pristine_tile(std::size_t brick) const {
    if (state_[brick] & uniform) return nullptr;
    return state_[brick] & saved ? pristine_.tile(brick) : density_.tile(brick);
  }
  std::uint8_t pristine_level(std::size_t brick) const { return level_[brick]; }
  /// Whether a brick holds pristine levels 1..31, where the scheme `layer` errs.
  bool has_faint(std::size_t brick) const { return state_[brick] & faint; }
  /// The levels of a brick, to be eroded in place. Saves the pristine ones first if needed.
  std::uint8_t* open(std::size_t brick);
  /// To be called after the erosion of a brick, with its sums `now`. A brick of several tissues also needs
  /// its levels `before`, aligned to a cache line; they become each voxel's loss. Returns the levels lost.
  std::int64_t close(const Index3& at, std::size_t brick, const BrickSums& now, std::uint8_t* before);

 private:
  friend class BoneView;
  enum State : std::uint8_t {
    uniform = 1,  // the pristine level is `level_` throughout
    saved = 2,    // the pristine levels are in `pristine_`; without both flags they equal the present ones
    eroded = 4,   // the present levels may differ from the pristine ones
    faint = 8,    // some pristine levels lie in 1..31
    changed = 16  // since `take_changed`
  };

  struct Users {
    std::atomic<int> count{0};  // -1: one thread changes the bone; else the number of readers
    Users() = default;
    Users(const Users&) {}  // a copy has no users
    Users& operator=(const Users&) { return *this; }
  };
  struct Sum : std::atomic<std::int64_t> {  // one thread changes it at a time, any may read
    Sum(std::int64_t value = 0) : atomic(value) {}
    Sum(const Sum& other) : atomic(std::int64_t(other)) {}
    Sum& operator=(const Sum& other) { return store(other, std::memory_order_relaxed), *this; }
    void operator+=(std::int64_t more) { *this = *this + more; }
    void operator-=(std::int64_t less) { *this = *this - less; }
  };

  VoxelBone(const Index3& shape, const Vec3& spacing, const Vec3& origin);
  [[noreturn]] static void refuse_use(int users);
  Index3 extent(const Index3& at) const;  // voxels of a brick within the volume
  void copy_pristine(const Index3& at, std::size_t brick, std::uint8_t* tile) const;
  void update_brick(const Index3& at, std::size_t brick, const std::uint8_t* pristine);
  std::int64_t pristine_mass(const Index3& at, std::size_t brick) const;
  void count_tissues(std::size_t brick, int sign);
  void set_box(const Index3& start, const Index3& shape, const std::uint8_t* levels, bool pristine_too);
  void set_tile(std::size_t brick, const std::uint8_t* levels);

  Index3 shape_, bricks_;
  Vec3 spacing_, origin_;
  Tiles density_, pristine_;  // `pristine_` only where a brick is not uniform
  std::shared_ptr<BrickVersions> versions_;
  std::vector<BrickSums> sums_;
  Levels level_;  // pristine level of uniform bricks
  Levels state_;
  Occupancy occupancy_;
  Sum level_sum_, pristine_sum_;
  std::shared_ptr<const TissueMap> tissues_;
  struct {
    TissueMap::Sums present{}, pristine{};  // of levels, by tissue
  } tissue_sums_;
  mutable Users users_;
  /// @endcond
};

}  // namespace burrlab
