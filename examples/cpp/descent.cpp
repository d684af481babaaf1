// The paper's experiment: a burr sinks under a constant force. Prints the velocities beside the mean field's and
// writes a table for `burrlab fit descent.csv --radius 3`.
#include <burrlab/burrlab.hpp>
#include <cstdio>

using namespace burrlab;

// Velocity between the immersions R/6 and R/3 [mm/s]; NaN if the burr does not get so far.
double measured(const Burr& burr, const Material& material, double force, double spacing) {
  const double R = burr.radius, dt = 1.0;
  const auto bone = std::make_shared<VoxelBone>(half_space(burr, spacing, R / 3.0));
  BurrContact contact(bone, burr, material, /*seed=*/1);
  const HeldDescent descent =
      contact.hold(force, {0.0, 0.0, R}, {0.0, 0.0, -1.0}, 0.0, R / 3.0 + spacing, dt, 100000);
  std::vector<double> time, immersion;  // of the points at which it was deeper than ever before
  for (std::size_t tick = 0; tick < descent.position.size(); ++tick) {
    if (!immersion.empty() && descent.position[tick] <= immersion.back()) continue;
    time.push_back(1e-3 * dt * double(tick));  // [s]
    immersion.push_back(descent.position[tick]);
  }
  if (immersion.size() < 2 || immersion.front() > R / 6.0 || immersion.back() < R / 3.0) return NAN;
  return window_velocity(time, immersion, R / 6.0, R / 3.0);
}

// The same without voxels: lengths in R, times in 1/alpha.
double mean_field(const Burr& burr, const Material& material, double force) {
  const double phi = force / (material.c_e * burr.radius * burr.radius);
  const MeanFieldDescent descent = mean_field_descent(material.shape, phi, 1.0 / 3.0);
  return 1e3 * material.alpha * burr.radius *
         window_velocity(descent.time, descent.immersion, 1.0 / 6.0, 1.0 / 3.0);
}

int main() {
  const Burr burr(3.0);
  const Material& material = paper_material("bone");
  std::FILE* table = std::fopen("descent.csv", "w");
  if (!table) return std::perror("descent.csv"), 1;
  std::fprintf(table, "# radius_mm: %g\nforce_N,velocity_mm_s\n", burr.radius);
  std::puts("force [N]  voxels [mm/s]  mean field [mm/s]");
  for (const double force : {0.3, 0.4, 0.6, 0.8, 1.1}) {
    const double velocity = measured(burr, material, force, 0.1);
    std::printf("%9.2f  %13.4f  %17.4f\n", force, velocity, mean_field(burr, material, force));
    std::fprintf(table, "%g,%.6g\n", force, velocity);
  }
  return std::fclose(table);
}
