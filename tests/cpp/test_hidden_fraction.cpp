// The part of the burr that parcels hide, in cases with a known answer.
#include "effects/hidden_fraction.hpp"

#include <cmath>

#include "check.hpp"

using namespace burrlab;

namespace {

const double quantum = 1e-3;
const BurrAt burr{Vec3(0.0, 0.0, 0.0), 2.0};

Camera above() {
  Camera camera;
  camera.position = Vec3(0.0, 0.0, 100.0);
  camera.up = Vec3(0.0, 1.0, 0.0);
  return camera;
}

EffectParameters opaque() {
  EffectParameters parameters;
  parameters.dust_opacity = 1.0;
  parameters.dust_bulking = 1.0;
  return parameters;
}

/// A parcel of dust with this radius [mm].
void put(Parcels& parcels, const Vec3& place, double radius, int substance = dust) {
  Quanta mass{};
  mass[std::size_t(substance)] =
      std::llround(4.0 / 3.0 * 3.14159265358979 * radius * radius * radius / quantum);
  parcels.add(place, Vec3::Zero(), mass);
}

double hidden(const Parcels& parcels, const Camera& camera = above(), const EffectParameters& p = opaque()) {
  return hidden_fraction(parcels, quantum, p, camera, burr);
}

void known() {
  Parcels none, big, small, behind, inside;
  CHECK(hidden(none) == 0.0);
  put(big, Vec3(0.0, 0.0, 50.0), 20.0);
  CHECK(hidden(big) == 1.0);
  put(behind, Vec3(0.0, 0.0, -5.0), 20.0);
  put(behind, Vec3(0.0, 0.0, 200.0), 50.0);
  CHECK(hidden(behind) == 0.0);
  put(inside, Vec3(0.0, 0.0, 1.0), 1.0);
  CHECK(hidden(inside) == 0.0);
  // Half the disc's radius at half the distance, a quarter of its area; the disc is seen under asin(R/D).
  put(small, Vec3(0.0, 0.0, 50.0), 0.5);
  CHECK_NEAR(hidden(small), 0.25, 0.01);
}

/// A parcel so large that its edge is straight across the middle of the disc hides half.
void half_plane() {
  Parcels parcels;
  put(parcels, Vec3(400.0, 0.0, 60.0), 400.0);
  Camera camera = above();
  camera.position = Vec3(0.0, 0.0, 100.0);
  CHECK_NEAR(hidden(parcels, camera), 0.5, 0.01);
}

/// The light of each layer multiplies; opacity mixes by volume.
void layers() {
  EffectParameters parameters = opaque();
  parameters.dust_opacity = 0.5;
  parameters.water_opacity = 0.1;
  Parcels parcels;
  put(parcels, Vec3(0.0, 0.0, 50.0), 20.0);
  put(parcels, Vec3(0.0, 0.0, 40.0), 20.0, water);
  CHECK_NEAR(hidden(parcels, above(), parameters), 1.0 - 0.5 * 0.9, 1e-12);
  Parcels mixed;
  mixed.add(Vec3(0.0, 0.0, 50.0), Vec3::Zero(), {50000000, 0, 50000000});
  CHECK_NEAR(hidden(mixed, above(), parameters), 0.3, 1e-12);
}

/// The fraction depends neither on the burr's place in the picture nor on the camera's turn.
void views() {
  Parcels parcels;
  put(parcels, Vec3(0.0, 0.0, 50.0), 0.5);
  Camera turned = above();
  turned.up = Vec3(0.6, 0.8, 0.0);
  CHECK_NEAR(hidden(parcels, turned), 0.25, 0.01);
  turned.look_at = Vec3(10.0, 5.0, 0.0);
  CHECK_NEAR(hidden(parcels, turned), 0.25, 0.01);
  turned.look_at = Vec3(100.0, 0.0, 80.0);
  CHECK(std::isnan(hidden(parcels, turned)));
  turned.look_at = Vec3(0.0, 0.0, 200.0);
  CHECK(std::isnan(hidden(parcels, turned)));
}

void refusals() {
  const Parcels none;
  Camera camera = above();
  camera.aspect = 0.0;
  CHECK_THROWS(hidden(none, camera), "aspect of the camera");
}

}  // namespace

int main() {
  known();
  half_plane();
  layers();
  views();
  refusals();
  return check::report();
}
