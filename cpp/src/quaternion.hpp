// Orientations: unit quaternions (w, x, y, z), and rotation matrices row by row.
#pragma once

#include <Eigen/Geometry>

#include "burrlab/types.hpp"
#include "require.hpp"

namespace burrlab {

using RotationRows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

inline bool is_unit(const Quaternion& q) {
  return std::abs(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1.0) <= 1e-3;
}

inline void require_unit(const std::string& name, const Quaternion& q) {
  if (!is_unit(q))
    refuse("length of " + name, "1", std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]));
}

inline Eigen::Quaterniond to_eigen(const Quaternion& q) { return {q[0], q[1], q[2], q[3]}; }

/// The part of the shorter way from one orientation to another; by roots only, the same on every CPU.
inline Quaternion between(const Quaternion& from, const Quaternion& to, double part) noexcept {
  const Eigen::Vector4d a(from.data()), b(to.data());
  const Eigen::Vector4d q = ((1.0 - part) * a + (a.dot(b) < 0.0 ? -part : part) * b).normalized();
  return {q[0], q[1], q[2], q[3]};
}

/// A rotation as a quaternion with w >= 0; false if the matrix is none, to 1 %.
inline bool to_quaternion(const RotationRows& rotation, Quaternion& quaternion) noexcept {
  const double off = (rotation * rotation.transpose() - RotationRows::Identity()).cwiseAbs().sum();
  if (!(off <= 1e-2 && rotation.determinant() > 0.0)) return false;
  const Eigen::Quaterniond q = Eigen::Quaterniond(Eigen::Matrix3d(rotation)).normalized();
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  quaternion = {sign * q.w(), sign * q.x(), sign * q.y(), sign * q.z()};
  return true;
}

}  // namespace burrlab
