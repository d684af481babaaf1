// What the surgeon holds beside the burr: a nozzle of water, a sucker; and where the eye is.
#pragma once

#include "burrlab/types.hpp"

namespace burrlab {

/// Irrigation. Its place is that of a burr plus `position`, or, with `burr` below zero, `position` itself.
struct Nozzle {
  Vec3 position = Vec3(6.0, 0.0, 8.0);     ///< [mm]
  Vec3 direction = Vec3(-0.6, 0.0, -0.8);  ///< of the jet
  double rate = 150.0;                     ///< [mm^3/s]
  double speed = 800.0;                    ///< of the jet [mm/s]
  int burr = 0;                            ///< number of the burr that it moves with

  /// Throws unless all is finite, the direction not zero, the rate and the speed from 0 to 1e6.
  void check() const;
};

/// Takes up parcels within `radius` of its tip, and draws the air within `reach` to it.
struct Sucker {
  Vec3 position = Vec3::Zero();  ///< of the tip [mm]
  double radius = 1.5;           ///< [mm]
  double reach = 8.0;            ///< [mm]
  double rate = 300.0;           ///< that it takes up at most [mm^3/s]
  double pull = 1500.0;  ///< speed of the air at the tip's rim; falls with the square of the distance [mm/s]

  /// Throws unless the radius is positive, the reach at least the radius, the rest not negative.
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

  /// Throws unless it looks somewhere, `up` is not along the view, and the angle lies in 1..170 degrees.
  void check() const;
};

}  // namespace burrlab
