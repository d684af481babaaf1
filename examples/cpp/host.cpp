// The shape of a plug-in of another simulator: it owns the loop, the pose, the units (metres) and the frame.
#include <burrlab/burrlab.hpp>
#include <cstdio>

using burrlab::Vec3;

// What the simulator calls. Its volume lies turned and shifted in its world; its steps have no even length.
class DrillPlugin {
 public:
  // Levels 0..255 (z, y, x) of the simulator's volume, its voxel [m], and the pose that takes a point of the
  // volume [m], whose origin is the volume's corner, to the world: rows of (R | t).
  DrillPlugin(const burrlab::Index3& shape, const std::vector<std::uint8_t>& levels, double voxel,
              const std::array<double, 12>& pose, double drill_radius)
      : bone_(std::make_shared<burrlab::VoxelBone>(shape, levels, Vec3::Constant(1e3 * voxel),
                                                   Vec3::Constant(0.5e3 * voxel))),  // centre of voxel 0
        burr_(bone_, burrlab::Burr(1e3 * drill_radius), burrlab::paper_material("bone"), settings_of(pose)) {}

  // Each step of physics: the drill's tip and the tool's centre of mass in the world [m], dt [s].
  void physics_update(const Vec3& tip, const Vec3& center_of_mass, double dt, bool pedal) {
    if (!(dt > 0.0)) return;  // a simulator's clock may stand still
    const burrlab::HostForce feel = burr_.step(tip, 1e3 * dt, pedal, center_of_mass);
    if (feel.refused) return void(std::printf("burrlab: %s\n", feel.refused));
    force = feel.force;    // for the tool's body [N], in the world's axes
    torque = feel.torque;  // about its centre of mass [N m]
    removed += feel.removed;
  }
  std::string digest() const { return bone_->digest(); }

  Vec3 force = Vec3::Zero(), torque = Vec3::Zero();
  double removed = 0.0;  // [mm^3]

 private:
  // From the world [m] to the volume [mm]: the inverse of the pose, times 1000.
  static burrlab::HostSettings settings_of(const std::array<double, 12>& pose) {
    burrlab::HostSettings settings;
    for (std::size_t i = 0; i < 3; ++i) {
      settings.to_bone[4 * i + 3] = 0.0;
      for (std::size_t j = 0; j < 3; ++j) {
        settings.to_bone[4 * i + j] = 1e3 * pose[4 * j + i];
        settings.to_bone[4 * i + 3] -= 1e3 * pose[4 * j + i] * pose[4 * j + 3];
      }
    }
    return settings;
  }

  std::shared_ptr<burrlab::VoxelBone> bone_;
  burrlab::HostBurr burr_;
};

int main() {
  const burrlab::Index3 shape{40, 60, 60};  // 12 x 12 x 8 mm of solid bone
  const std::vector<std::uint8_t> levels(40 * 60 * 60, 255);
  // The volume's z axis is the world's x axis.
  DrillPlugin drill(shape, levels, 0.0002, {0, 0, 1, 0.1, 1, 0, 0, 0.2, 0, 1, 0, 0.3}, 0.003);
  for (int step = 0; step < 600; ++step) {
    const double dt = step % 2 ? 0.0009 : 0.0011, depth = 0.000002 * step;
    const Vec3 tip(0.1 + 0.008 + 0.003 - depth, 0.206, 0.306);
    drill.physics_update(tip, tip + Vec3(0.0, 0.0, 0.1), dt, true);
    if (step % 100 == 99)
      std::printf("%.3f N along x, %.4f N m about y\n", drill.force.x(), drill.torque.y());
  }
  std::printf("removed %.3f mm^3, bone %s\n", drill.removed, drill.digest().c_str());
}
