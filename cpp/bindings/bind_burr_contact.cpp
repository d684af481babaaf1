#include <optional>

#include "contact_series.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

// Ctrl-C during long work: the GIL is taken for a moment, every `period` ticks.
void check_interrupt() {
  const py::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

ContactSeries run(BurrContact& contact,
                  const py::array_t<double, py::array::c_style | py::array::forcecast>& path, double dt,
                  bool burr_on) {
  constexpr std::size_t period = 512;
  if (path.ndim() != 2 || path.shape(1) != 3) {
    throw std::invalid_argument("path must have shape (n, 3), points (x, y, z) [mm], got " +
                                std::string(py::str(path.attr("shape"))));
  }
  std::vector<Vec3> centers(static_cast<std::size_t>(path.shape(0)));
  for (std::size_t i = 0; i < centers.size(); ++i) {
    centers[i] = Eigen::Map<const Vec3>(path.data(static_cast<py::ssize_t>(i), 0));
    for (int axis = 0; axis < 3; ++axis) require_finite("every point of path", centers[i][axis]);
  }
  require_positive("dt", dt);
  ContactSeries series;
  const py::gil_scoped_release release;
  series.contacts.reserve(centers.size());
  std::optional<VoxelBone::Changing> changing;
  for (std::size_t i = 0; i < centers.size(); ++i) {
    if (i % period == 0) {
      changing.reset();  // whom the interrupt calls may use the bone
      if (i > 0) check_interrupt();
      changing.emplace(*contact.bone());
    }
    series.contacts.push_back(contact.step(centers[i], burr_on ? &contact.steps_of(dt) : nullptr));
  }
  return series;
}

}  // namespace

void bind_burr_contact(py::module_& m) {
  py::class_<BurrContact>(m, "BurrContact", R"(A burr on a bone: force and erosion, tick by tick.

Parameters
----------
bone : VoxelBone
    Shared, and eroded in place.
burr : Burr
material : Material
    In a bone with tissues that of their table: its f holds for all of them.
seed : int
    0 to 2^64 - 1. The random numbers of a tick are a pure function of (seed, tick, index, voxel).
index : int
    Numbers the burrs on one bone; they act in the order of their steps.
scheme : {"layer", "cell"}
    ``cell`` is the paper's: a voxel is uniform. ``layer`` resolves the layer in which a burr cuts inside the voxel,
    so that results do not depend on voxel size.

Raises
------
ValueError
    If the radius is below 4 voxels, the scheme unknown, the material not that of the bone's tissues, or the burr
    too large for their c_e (200 voxels of radius at 1000 N/mm^2). Of every method: if another thread uses the bone;
    any number may `probe` it (docs/session.md).

Notes
-----
In a bone with tissues c_e is the mean over the mass inside the sphere, and every voxel erodes at its tissue's alpha.

References
----------
Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004, Eqs. 1-4.

Examples
--------
>>> import burrlab
>>> bone = burrlab.VoxelBone.block((8, 8, 3), 0.1, origin=(-4, -4, -3))
>>> contact = burrlab.BurrContact(bone, burrlab.Burr(3.0), burrlab.materials["bone"], seed=1)
>>> felt = contact.step((0.0, 0.0, 2.6), dt=1.0)
>>> felt.touching, felt.tick, contact.tick
(True, 0, 1)
)")
      .def(py::init([](std::shared_ptr<VoxelBone> bone, const Burr& burr, const Material& material,
                       std::uint64_t seed, std::uint32_t index, const std::string& scheme) {
             return BurrContact(std::move(bone), burr, material, seed, index, parse_scheme(scheme));
           }),
           py::arg("bone"), py::arg("burr"), py::arg("material"), py::arg("seed"), py::arg("index") = 0,
           py::kw_only(), py::arg("scheme") = "layer")
      .def(
          "probe",
          [](const BurrContact& contact, const Vec3& center) {
            const VoxelBone::Reading reading(*contact.bone());
            return contact.probe(center);
          },
          py::arg("center"), py::call_guard<py::gil_scoped_release>(),
          "The contact at `center` (x, y, z) [mm] now: no erosion, no tick. ValueError if it is not finite.")
      .def("step", py::overload_cast<const Vec3&, double, bool>(&BurrContact::step), py::arg("center"),
           py::arg("dt"), py::arg("burr_on") = true, py::call_guard<py::gil_scoped_release>(),
           R"(One tick: the force at `center`, then erosion.

Parameters
----------
center : (x, y, z)
    [mm]
dt : float
    [ms]
burr_on : bool
    Without it nothing erodes; the tick counts all the same.

Returns
-------
Contact

Raises
------
ValueError
    If the centre is not finite or dt not positive.
)")
      .def(
          "erode", &BurrContact::erode, py::arg("center"), py::arg("dt"),
          py::call_guard<py::gil_scoped_release>(),
          R"(The erosion of a tick without its force; after `probe`, which gives the force sooner, the same as `step`.

Parameters
----------
center : (x, y, z)
    [mm]
dt : float
    [ms]

Returns
-------
float
    Solid bone removed [mm^3].

Raises
------
ValueError
    If the centre is not finite or dt not positive.
)")
      .def("run", &run, py::arg("path"), py::arg("dt"), py::arg("burr_on") = true,
           R"(One tick at every point of a path, in one call; the same as `step` point by point.

Parameters
----------
path : array_like, shape (n, 3)
    Centres (x, y, z) [mm].
dt : float
    [ms]
burr_on : bool

Returns
-------
ContactSeries

Raises
------
ValueError
    If the path has another shape or a value that is not finite, or dt is not positive; nothing is eroded then.
KeyboardInterrupt
    On Ctrl-C; the ticks done so far stay done, `tick` tells how many.
)")
      .def(
          "hold",
          [](BurrContact& contact, double force, const Vec3& start, const Vec3& axis, double from,
             double travel, double dt, std::int64_t ticks) {
            const py::gil_scoped_release release;
            return contact.hold(force, start, axis, from, travel, dt, ticks, check_interrupt);
          },
          py::arg("force"), py::arg("start"), py::arg("axis"), py::kw_only(), py::arg("from_"),
          py::arg("travel"), py::arg("dt"), py::arg("ticks"),
          R"(Sinks at an exactly constant axial force: every tick acts where the force is as asked.

Parameters
----------
force : float
    [N]
start : (x, y, z)
    Burr centre at position 0 [mm].
axis : (x, y, z)
    Unit vector into the bone.
from_, travel : float
    First and last position along the axis [mm].
dt : float
    [ms]
ticks : int
    At most so many.

Returns
-------
HeldDescent

Raises
------
ValueError
    If the force or dt is not positive, or the axis not of length 1.
)")
      .def_readwrite("tick", &BurrContact::tick, "Number of the next tick; settable, for replay.")
      .def_property_readonly("bone", &BurrContact::bone)
      .def_property_readonly("burr", &BurrContact::burr)
      .def_property_readonly("material", &BurrContact::material)
      .def_property_readonly("seed", &BurrContact::seed)
      .def_property_readonly("index", &BurrContact::index)
      .def_property_readonly(
          "scheme", [](const BurrContact& c) { return c.scheme() == Scheme::layer ? "layer" : "cell"; });
}
