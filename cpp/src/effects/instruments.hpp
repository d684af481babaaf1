// Instruments beside the burr, a nozzle and a sucker, and the camera.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// Irrigation. The nozzle is at `position`, counted from the centre of a burr unless `burr` is negative.
struct Nozzle {
  Vec3 position = Vec3(6.0, 0.0, 8.0);     ///< [mm]
  Vec3 direction = Vec3(-0.6, 0.0, -0.8);  ///< of the jet
  double rate = 150.0;                     ///< [mm^3/s]
  double speed = 800.0;                    ///< of the jet [mm/s]
  int burr = 0;                            ///< number of the burr it moves with

  /// Throws unless all is finite, the direction is not zero, and rate and speed are from 0 to 1e6.
  void check() const;
};

/// Takes up parcels within `radius` of its tip, and draws air from within `reach`.
struct Sucker {
  Vec3 position = Vec3::Zero();  ///< of the tip [mm]
  double radius = 1.5;           ///< [mm]
  double reach = 8.0;            ///< [mm]
  double rate = 300.0;           ///< most it takes up [mm^3/s]
  double pull = 1500.0;          ///< air speed at the tip's rim, falling with distance squared [mm/s]

  /// Throws unless the radius is positive, the reach at least the radius, and the rest not negative.
  void check() const;
  /// Velocity of the air at a place [mm/s].
  Vec3 air(const Vec3& place) const;
};

/// A perspective view.
struct Camera {
  Vec3 position = Vec3(0.0, -40.0, 60.0);  ///< [mm]
  Vec3 look_at = Vec3::Zero();             ///< [mm]
  Vec3 up = Vec3(0.0, 0.0, 1.0);
  double view_angle = 30.0;   ///< vertical, whole [degrees]
  double aspect = 4.0 / 3.0;  ///< width over height

  /// Throws unless it looks at another place, `up` is not along the view, and the angle is in 1..170 degrees.
  void check() const;
};

}  // namespace burrlab
