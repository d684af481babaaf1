// The stiffness of a contact along its normal, and the limits of a passive loop (docs/stability.md).
#pragma once

#include <limits>

#include "burrlab/session/device.hpp"
#include "burrlab/session/tick_executor.hpp"

namespace burrlab {

/// From k = dF/dH = q c_e u^(q-1) A/(pi R (2 u - u^2)) [N/mm]: the wetted area A, projected on the normal
/// [mm^2], of a contact with this stiffness at a force [N]; c_e [N/mm^2], u from the force F = c_e R^2 u^q, q
/// = 3/2 in Eq. 3. Not dF/dh: bone enters over the whole wetted area at once.
double contact_area(double force, double stiffness, double radius, double c_e,
                    double force_exponent = Material::paper_force_exponent);

/// k from the force at `step` [mm] in and out along the contact's normal [N/mm]; 0 without contact. Where the
/// burr comes free within a step it is an average, below k.
double measured_stiffness(const TickExecutor& executor, std::size_t burr, const Vec3& center,
                          double step = 0.02);

/// k in the direction in which it is largest, from the force at `step` [mm] in and out along each axis: the
/// largest eigenvalue of the symmetric part; 0 without contact. In a hole deeper than R/2 the walls can be
/// stiffer than the ground.
double stiffest_contact(const TickExecutor& executor, std::size_t burr, const Vec3& center,
                        double step = 0.02);

/// Stiffness below which a sampled spring is passive [N/mm]: b/(T/2 + t_d), with damping b [N s/m], period T
/// and age of the position t_d [ms] (Colgate, Schenkel 1997).
double passivity_limit(double damping, double period, double age = 0.0);
/// Stiffness below which friction absorbs the energy of an encoder's steps: 2 f_c/Delta [N/mm], friction [N],
/// step [mm] (Abbott and Okamura 2005); infinite for a step of 0.
double encoder_limit(double friction, double encoder_step);

/// For q < 2 the force below which a contact of this wetted area is stiffer than `limit` [N]: the smallest
/// root of u^(2-q) (2 - u) = q c_e A/(pi R limit); infinite if every force up to u = 2 (2-q)/(3-q) is below
/// it. For q >= 2 k rises with the force from u = 0 on, and this is the force above which it is stiffer.
double force_at_limit(double limit, double area, double radius, double c_e,
                      double force_exponent = Material::paper_force_exponent);

/// The stability that a session reports; NaN if a number is unknown.
struct StabilityReport {
  static constexpr double warning_ratio = 0.8;

  double force = 0.0;                                                    ///< [N]
  double k = 0.0;                                                        ///< contact stiffness [N/mm]
  double area = 0.0;                                                     ///< wetted area that gives k [mm^2]
  double limit = std::numeric_limits<double>::quiet_NaN();               ///< the lower of the next two [N/mm]
  double sampling_limit = std::numeric_limits<double>::quiet_NaN();      ///< `passivity_limit` [N/mm]
  double quantisation_limit = std::numeric_limits<double>::quiet_NaN();  ///< `encoder_limit` [N/mm]
  double ratio = std::numeric_limits<double>::quiet_NaN();               ///< k/limit
  double delay = 0.0;  ///< from a position to the middle of its force's time, T/2 + t_d [ms]
  double force_at_limit = std::numeric_limits<double>::quiet_NaN();  ///< below it k > limit, in this hole [N]
  bool stiffer_above = false;                                        ///< for q >= 2, k > limit above it
  bool warning = false;                                              ///< ratio above 0.8
};

/// Report of a contact of stiffness k [N/mm] at a force [N]; period and age [ms]. A `coupling` [N/mm] is in
/// series with the contact: the reported k is what the hand meets.
StabilityReport stability_report(double force, double k, const Tool& tool, const DeviceModel& device,
                                 double period, double age = 0.0,
                                 double coupling = std::numeric_limits<double>::infinity());

}  // namespace burrlab
