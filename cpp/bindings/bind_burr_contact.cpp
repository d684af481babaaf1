#include <algorithm>

#include "bindings.hpp"

namespace {

/// The contacts along a path; columns are copied as arrays.
struct ContactSeries {
  std::vector<Contact> contacts;
};

template <class Value>
auto column(Value Contact::* field) {
  return [field](const ContactSeries& series) {
    constexpr bool is_vector = std::is_same_v<Value, Vec3>;
    std::vector<py::ssize_t> shape{py::ssize_t(series.contacts.size())};
    if constexpr (is_vector) shape.push_back(3);
    py::array_t<std::conditional_t<is_vector, double, Value>> out(shape);
    auto* to = out.mutable_data();
    for (const Contact& contact : series.contacts)
      if constexpr (is_vector)
        to = std::copy_n((contact.*field).data(), 3, to);
      else
        *to++ = contact.*field;
    return out;
  };
}

template <class Value>
auto array_of(std::vector<Value> HeldDescent::* field) {
  return [field](const HeldDescent& descent) { return to_array(descent.*field); };
}

void bind_contact(py::module_& m) {
  Class<Contact> contact(m, "Contact",
                         "The contact of one tick; its force is that before the tick's erosion.");
  Class<ContactSeries> series(
      m, "ContactSeries",
      "The contacts along a path; every column is a copy with one row a tick, (n,) or (n, 3).");
  const auto def = [&](const char* name, auto field, const char* doc) {
    contact.def_readonly(name, field, doc);
    series.def_readonly(name, column(field), doc);
  };
  def("force", &Contact::force, "(3,) [N], out of the bone");
  def("normal", &Contact::normal, "(3,) out of the bone; shorter than 1 where ambiguous");
  def("penetration", &Contact::penetration, "Effective depth h, Eq. 2 [mm]");
  def("c_e", &Contact::c_e,
      "Elastic constant of Eq. 3 [N/mm^2]: in a bone with tissues, the mean over the mass inside the sphere; "
      "else, or without mass, the material's");
  def("m0", &Contact::m0, "[mm^3]");
  def("m1", &Contact::m1, "(3,) [mm^4]");
  def("removed", &Contact::removed, "Solid bone removed in the tick [mm^3]");
  def("tick", &Contact::tick, "Number of the tick");
  def("touching", &Contact::touching, "There is bone inside the sphere");
  def("ambiguous", &Contact::ambiguous, "|m_1| < 0.1 m_0 R: no direction, the force fades");
  def("coarse", &Contact::coarse, "The radius is below 7.5 voxels");
  def("faint", &Contact::faint,
      "Over 5 % of the mass is in voxels with pristine level below 32, where `layer` errs");
  contact.def("__repr__", [](const Contact& c) {
    return format(
        "Contact(tick={}, force=({:.4g}, {:.4g}, {:.4g}) N, penetration={:.4g} mm, removed={:.3g} "
        "mm^3{}{}{})",
        c.tick, c.force[0], c.force[1], c.force[2], c.penetration, c.removed,
        c.ambiguous ? ", ambiguous" : "", c.coarse ? ", coarse" : "", c.faint ? ", faint" : "");
  });
  series.def("__len__", [](const ContactSeries& s) { return s.contacts.size(); })
      .def("__getitem__", [](const ContactSeries& s, py::ssize_t i) {
        const auto n = static_cast<py::ssize_t>(s.contacts.size());
        if (i < -n || i >= n) throw py::index_error("tick " + std::to_string(i) + " of " + std::to_string(n));
        return s.contacts[static_cast<std::size_t>(i < 0 ? i + n : i)];
      });

  Class<HeldDescent>(m, "HeldDescent", "A descent under an exactly constant force, tick by tick.")
      .def_readonly("position", array_of(&HeldDescent::position),
                    "(n,) along the axis from the start, before each tick's erosion [mm]")
      .def_readonly("force", array_of(&HeldDescent::force), "(n,) axial, as solved [N]")
      .def_readonly("removed", array_of(&HeldDescent::removed), "(n,) [mm^3]")
      .def_readonly("ambiguous", &HeldDescent::ambiguous, "Number of ticks whose contact has no direction")
      .def_readonly("faint", &HeldDescent::faint,
                    "Number of ticks with over 5 % of the mass in voxels with pristine level below 32")
      .def_readonly("reached", &HeldDescent::reached, "The burr came to the end of its travel");
}

// Lets Ctrl-C end long work; takes the GIL briefly.
void check_interrupt() {
  const py::gil_scoped_acquire gil;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

ContactSeries run(BurrContact& contact, const Reals& path, double dt, bool burr_on) {
  constexpr std::size_t period = 512;
  if (path.ndim() != 2 || path.shape(1) != 3)
    throw std::invalid_argument("path must have shape (n, 3), points (x, y, z) [mm], got " +
                                std::string(py::str(path.attr("shape"))));
  std::vector<Vec3> centers(static_cast<std::size_t>(path.shape(0)));
  for (std::size_t i = 0; i < centers.size(); ++i) {
    centers[i] = Eigen::Map<const Vec3>(path.data(static_cast<py::ssize_t>(i), 0));
    require_finite("every point of path", centers[i]);
  }
  require_positive("dt", dt);
  ContactSeries series;
  const py::gil_scoped_release release;
  series.contacts.reserve(centers.size());
  for (std::size_t i = 0; i < centers.size();) {
    if (i > 0) check_interrupt();  // Python code that it calls may use the bone
    const VoxelBone::Changing changing(*contact.bone());
    for (const std::size_t end = std::min(i + period, centers.size()); i < end; ++i)
      series.contacts.push_back(contact.step(centers[i], burr_on ? &contact.steps_of(dt) : nullptr));
  }
  return series;
}

}  // namespace

void bind_burr_contact(py::module_& m) {
  bind_contact(m);
  Class<BurrContact>(m, "BurrContact", R"(A burr on a bone: force and erosion, tick by tick.

Parameters
----------
bone : VoxelBone
    Shared, and eroded in place.
burr : Burr
material : Material
    In a bone with tissues, that of their table.
seed : int
    0 to 2^64 - 1. A tick's random numbers are a pure function of (seed, tick, index, voxel).
index : int
    Number of the burr on the bone. Burrs act in the order of their steps.
scheme : {"layer", "cell"}
    ``cell`` is the paper's: a voxel is uniform. ``layer`` resolves the layer in which a burr cuts, so that
    results do not depend on voxel size.

Raises
------
ValueError
    If the radius is below 4 voxels, the scheme unknown, the material not that of the bone's tissues, or the
    burr too large for their c_e (200 voxels of radius at 1000 N/mm^2). From every method, if another thread
    uses the bone; any number may `probe` it (docs/session.md).

Notes
-----
In a bone with tissues c_e is the mean over the mass inside the sphere, and voxels erode at their
tissue's alpha.

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
           "bone"_a, "burr"_a, "material"_a, "seed"_a, "index"_a = 0, py::kw_only(), "scheme"_a = "layer")
      .def(
          "probe",
          [](const BurrContact& contact, const Vec3& center) {
            const VoxelBone::Reading reading(*contact.bone());
            return contact.probe(center);
          },
          "center"_a, no_gil,
          "The contact at `center` (x, y, z) [mm], without erosion or a tick. ValueError if it is not "
          "finite.")
      .def("step", py::overload_cast<const Vec3&, double, bool>(&BurrContact::step), "center"_a, "dt"_a,
           "burr_on"_a = true, no_gil,
           R"(One tick: the force at `center`, then erosion.

Parameters
----------
center : (x, y, z)
    [mm]
dt : float
    [ms]
burr_on : bool
    If False, nothing erodes; the tick still counts.

Returns
-------
Contact

Raises
------
ValueError
    If the centre is not finite or dt not positive.
)")
      .def("erode", &BurrContact::erode, "center"_a, "dt"_a, no_gil,
           R"(The erosion of a tick without its force; after `probe`, the same as `step`.

Parameters
----------
center, dt
    As for `step`.

Returns
-------
float
    Solid bone removed [mm^3].

Raises
------
ValueError
    As from `step`.
)")
      .def("run", &run, "path"_a, "dt"_a, "burr_on"_a = true,
           R"(One tick at every point of a path; the same as `step` point by point.

Parameters
----------
path : array_like, shape (n, 3)
    Centres (x, y, z) [mm].
dt, burr_on
    As for `step`.

Returns
-------
ContactSeries

Raises
------
ValueError
    If the path has another shape or a value that is not finite, or dt is not positive; nothing erodes then.
KeyboardInterrupt
    On Ctrl-C; `tick` tells how many ticks were done.
)")
      .def(
          "hold",
          [](BurrContact& contact, double force, const Vec3& start, const Vec3& axis, double from,
             double travel, double dt, std::int64_t ticks) {
            const py::gil_scoped_release release;
            return contact.hold(force, start, axis, from, travel, dt, ticks, check_interrupt);
          },
          "force"_a, "start"_a, "axis"_a, py::kw_only(), "from_"_a, "travel"_a, "dt"_a, "ticks"_a,
          R"(Sinks at an exactly constant axial force: each tick acts where the force is the one given.

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
    Most ticks.

Returns
-------
HeldDescent

Raises
------
ValueError
    If the force or dt is not positive, or the axis not of length 1.
)")
      .def_readonly("bone", &BurrContact::bone)
      .def_readonly("burr", &BurrContact::burr)
      .def_readonly("material", &BurrContact::material)
      .def_readonly("seed", &BurrContact::seed)
      .def_readonly("index", &BurrContact::index)
      .def_readonly("scheme",
                    [](const BurrContact& c) { return c.scheme() == Scheme::layer ? "layer" : "cell"; })
      .def_readwrite("tick", &BurrContact::tick, "Number of the next tick; settable, for replay.");
}
