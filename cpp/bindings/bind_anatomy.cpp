
#include "bindings.hpp"

namespace {

// One number per point; points are (x, y, z) along the last axis.
template <class Function>
py::array_t<double> at_points(const Reals& points, Function&& function) {
  if (points.ndim() < 1 || points.shape(points.ndim() - 1) != 3)
    throw std::invalid_argument("points must be (x, y, z) along their last axis");
  const std::vector<py::ssize_t> shape(points.shape(), points.shape() + points.ndim() - 1);
  py::array_t<double> out(shape);
  const double* in = points.data();
  for (py::ssize_t i = 0; i < points.size(); ++i) require_finite("every point", in[i]);
  double* to = out.mutable_data();
  const py::ssize_t count = out.size();
  const py::gil_scoped_release release;
  for (py::ssize_t i = 0; i < count; ++i) to[i] = function(Vec3(in[3 * i], in[3 * i + 1], in[3 * i + 2]));
  return out;
}

std::shared_ptr<StructureDistance> make_distance(const StructureSearch& search, const py::array& estimate,
                                                 double spacing, const Vec3& origin, double error) {
  const auto dense = py::array_t<float, py::array::c_style | py::array::forcecast>::ensure(estimate);
  if (!dense || dense.ndim() != 3) throw std::invalid_argument("estimate must have 3 dimensions (z, y, x)");
  const Index3 shape{dense.shape(0), dense.shape(1), dense.shape(2)};
  return std::make_shared<StructureDistance>(
      DistanceField(search, shape, dense.data(), spacing, origin, error));
}

using Limits = std::tuple<std::shared_ptr<StructureDistance>, double, double, double, double>;

std::shared_ptr<AnatomyWatch> make_watch(const std::vector<Limits>& structures,
                                         const std::vector<double>& radii) {
  std::vector<WatchedStructure> watched;
  for (const auto& [distance, approach, touch, injury, hysteresis] : structures) {
    if (!distance) throw std::invalid_argument("structure must be a StructureDistance, got None");
    watched.push_back({distance, {approach, touch, injury, hysteresis}});
  }
  return std::make_shared<AnatomyWatch>(std::move(watched), radii);
}

}  // namespace

py::dict to_dict(const AnatomyWatch& watch, std::size_t known) {
  const auto& events = watch.events();
  known = std::min(known, events.size());
  const std::size_t burrs = watch.burrs(), structures = watch.structures().size();
  std::vector<WatchDose> doses;
  std::vector<std::int64_t> removed;
  for (std::size_t burr = 0; burr < burrs; ++burr)
    for (std::size_t s = 0; s < structures; ++s) doses.push_back(watch.dose(burr, s));
  for (std::size_t s = 0; s < structures; ++s) removed.push_back(watch.removed(s));
  return py::dict("events"_a = to_array(events.data() + known, {py::ssize_t(events.size() - known)}),
                  "doses"_a = to_array(doses.data(), {py::ssize_t(burrs), py::ssize_t(structures)}),
                  "removed"_a = to_array(removed), "events_lost"_a = watch.events_lost(),
                  "gaps"_a = watch.gaps(), "ticks_passed_over"_a = watch.ticks_passed_over());
}

void bind_anatomy(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(WatchEvent, tick, kind, structure, burr, on, distance, force, removed, center);
  PYBIND11_NUMPY_DTYPE(WatchDose, distance, closest, closest_tick, closest_center, periods, turning, touching,
                       removed, near_periods, near_force, near_peak);
  m.attr("watch_event_dtype") = py::dtype::of<WatchEvent>();
  m.attr("watch_dose_dtype") = py::dtype::of<WatchDose>();
  m.attr("dose_edges") = py::tuple(py::cast(WatchDose::edges));
  m.attr("dose_near") = py::tuple(py::cast(WatchDose::near));
  m.attr("most_watch_events") = AnatomyWatch::most_events;

  m.def(
      "tissue_levels",
      [](const VoxelBone& bone) {
        const VoxelBone::Reading reading(bone);
        return to_array(bone.tissue_levels());
      },
      "bone"_a, "Levels left of each tissue, (tissues,) int64; empty without tissues.");

  Class<StructureSearch, std::shared_ptr<StructureSearch>>(
      m, "StructureSearch",
      "Exact distances to a structure: to the nearest of its voxels, each a box. ValueError if the bone has "
      "no tissues, or no voxel with this number.")
      .def(py::init<const VoxelBone&, std::size_t>(), "bone"_a, "tissue"_a)
      .def(
          "distance",
          [](const StructureSearch& search, const Reals& points) {
            NearestVoxel nearest;
            return at_points(points, [&](const Vec3& point) { return search.distance(point, nearest); });
          },
          "points"_a, "Distances [mm] of points (..., 3) [mm]; 0 inside. ValueError unless finite.")
      .def_readonly("low", &StructureSearch::low, "Corner of the box around it, (x, y, z) [mm]; a copy")
      .def_readonly("high", &StructureSearch::high, "The opposite corner [mm]; a copy");

  Class<StructureDistance, std::shared_ptr<StructureDistance>>(
      m, "StructureDistance",
      "Distances to a structure: exact near it, from a field far from it. `estimate` (z, y, x): distances "
      "[mm] at the field's nodes, wrong by at most `error` [mm]; those below 8 mm are made exact when they "
      "are first asked for. `spacing` of the nodes is at most 0.4 [mm]; `origin` (x, y, z) is the place of "
      "the first [mm]. ValueError if a value is out of range.")
      .def(py::init(&make_distance), "search"_a, "estimate"_a, "spacing"_a, "origin"_a, "error"_a)
      .def(
          "of_sphere",
          [](const StructureDistance& d, const Reals& centers, double radius) {
            require_not_negative("radius", radius);
            if (radius > AnatomyWatch::largest_radius) refuse("radius", "at most 6 mm", radius);
            NearestVoxel nearest;
            return at_points(centers,
                             [&](const Vec3& center) { return d.of_sphere(center, radius, nearest); });
          },
          "centers"_a, "radius"_a = 0.0,
          "Distances [mm] of the surfaces of spheres at centers (..., 3) [mm]: at least -radius, exact below "
          "1 mm, infinite beyond the field. ValueError unless finite, radius 0 to 6.")
      .def(
          "field",
          [](const StructureDistance& d, const Reals& points) {
            NearestVoxel nearest;
            return at_points(points, [&](const Vec3& point) { return d.field().at(point, nearest); });
          },
          "points"_a, "Distances [mm] at points (..., 3) [mm] by the field alone; infinite outside it.");

  Class<AnatomyWatch, std::shared_ptr<AnatomyWatch>>(
      m, "AnatomyWatch",
      "The watch over structures near a session's burrs; a TickExecutor, a Follower or a Replica runs it. "
      "`structures`: (StructureDistance, approach [mm], touch [mm], injury [mm^3], hysteresis [mm]) each. "
      "`radii` of the burrs are at most 6 [mm]. ValueError if there is no structure, they are of several "
      "bones, or a value is out of range.")
      .def(py::init(&make_watch), "structures"_a, "radii"_a)
      .def(
          "seen", [](const AnatomyWatch& watch, std::size_t known) { return to_dict(watch, known); },
          "known"_a = 0,
          "A dict: events (n,) watch_event_dtype, without the first `known`; doses (burrs, structures) "
          "watch_dose_dtype; removed (structures,) [levels]; events_lost, gaps, ticks_passed_over. Not while "
          "another thread executes.");
}
