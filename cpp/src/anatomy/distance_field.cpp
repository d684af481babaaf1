#include "burrlab/anatomy/distance_field.hpp"

#include <algorithm>

#include "burrlab/check.hpp"

namespace burrlab {

DistanceField::DistanceField(const StructureSearch& search, const Index3& shape, std::vector<float> estimate,
                             double spacing, const Vec3& origin, double error)
    : shape_(shape), values_(std::move(estimate)), spacing_(spacing), origin_(origin) {
  require_positive("spacing", spacing);
  if (spacing > 0.4) refuse("spacing", "at most 0.4 mm", spacing);
  require_not_negative("error", error);
  for (int axis = 0; axis < 3; ++axis) require_finite("origin", origin[axis]);
  for (const std::int64_t n : shape)
    if (n < 2) refuse("every side of a field", "at least 2", double(n));
  if (std::int64_t(values_.size()) != shape[0] * shape[1] * shape[2])
    throw std::invalid_argument("estimates must fill the shape of the field");
  std::size_t node = 0;
  NearestVoxel nearest;
  for (std::int64_t z = 0; z < shape[0]; ++z) {
    for (std::int64_t y = 0; y < shape[1]; ++y) {
      for (std::int64_t x = 0; x < shape[2]; ++x, ++node) {
        if (!(values_[node] - error < exact_to)) continue;
        const Vec3 place = origin + spacing * Vec3(double(x), double(y), double(z));
        values_[node] = float(search.distance(place, nearest));
      }
    }
  }
}

double DistanceField::at(const Vec3& point) const noexcept {
  std::size_t base = 0;
  double part[3];  // (z, y, x)
  for (int i = 0; i < 3; ++i) {
    const double place = (point[2 - i] - origin_[2 - i]) / spacing_;
    if (!(place >= 0.0 && place < double(shape_[i] - 1))) return std::numeric_limits<double>::infinity();
    const auto whole = std::int64_t(place);
    part[i] = place - double(whole);
    base = base * std::size_t(shape_[i]) + std::size_t(whole);
  }
  const std::size_t row = std::size_t(shape_[2]), slice = row * std::size_t(shape_[1]);
  const auto along_x = [&](std::size_t from) {
    return values_[from] + part[2] * (double(values_[from + 1]) - values_[from]);
  };
  const auto along_y = [&](std::size_t from) {
    const double first = along_x(from);
    return first + part[1] * (along_x(from + row) - first);
  };
  const double first = along_y(base);
  return first + part[0] * (along_y(base + slice) - first);
}

double DistanceField::depth(const Vec3& point) const noexcept {
  double least = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double from = point[axis] - origin_[axis];
    least = std::min({least, from, spacing_ * double(shape_[2 - axis] - 1) - from});
  }
  return least;
}

}  // namespace burrlab
