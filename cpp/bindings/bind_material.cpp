#include "bindings.hpp"
#include "burrlab/material.hpp"
#include "depth_table.hpp"

namespace {

std::vector<double> numbers(const py::object& values, const char* name) {
  const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(values);
  if (!array || array.ndim() != 1)
    throw std::invalid_argument(std::string(name) + " of a table must be a list of numbers, got " +
                                std::string(py::repr(values)));
  return {array.data(), array.data() + array.size()};
}

void bind_shape(py::module_& m) {
  Class<Shape>(m, "Shape", R"doc(Erosion shape function f(x), x = r/R, of Eq. 4.

The paper asks only for a maximum at r = 0 and zero beyond R. The family is our choice; an alpha belongs to
one f.

Parameters
----------
name : str or Shape
    ``"parabolic"`` 1 - x^2, ``"linear"`` 1 - x, ``"quartic"`` (1 - x^2)^2, ``"constant"`` 1,
    ``"power(k)"`` (1 - x^2)^k with 0 < k <= 8, or the name of a table; see `from_table`.

Raises
------
ValueError
    If the name is none of these or k is out of range.

Examples
--------
>>> import burrlab
>>> f = burrlab.Shape("power(1.5)")
>>> f.name, f.order, round(f(0.5), 4)
('power(1.5)', 1.5, 0.6495)
)doc")
      .def(py::init(&to_shape), "name"_a)
      .def_static(
          "from_table",
          [](const py::object& x, const py::object& f, std::optional<double> order) {
            const std::vector<double> at = numbers(x, "x");
            const bool tabulate = PyCallable_Check(f.ptr()) != 0;
            const py::object values = tabulate ? f(py::array_t<double>(at.size(), at.data())) : f;
            return Shape::from_table(at, numbers(values, "f"), order.value_or(std::nan("")));
          },
          "x"_a, "f"_a, py::kw_only(), "order"_a = py::none(),
          R"doc(A shape of your own, from a table or a function.

Parameters
----------
x : array_like, shape (n,)
    r/R, rising from 0 to 1 in steps of 1e-6 or more; 3 to 256 points.
f : array_like, shape (n,), or callable
    f at x, or a function that gives it for the array x. f(0) is the maximum, below x = 1 f is above 1e-9
    f(0), and f(1) is zero (to 1e-9 f(0)) or positive.
order : float, optional
    Order k of the zero at x = 1, in (0, 8]; 0 where f(1) > 0. By default the table's own: the slope of log f
    over log(1 - x), extrapolated to x = 1 from the last two, as a whole number where one lies within that
    step, else to 0.05. Three points, or slopes that differ much, give the whole number next to the last.

Returns
-------
Shape
    Its name holds the order and all numbers: whatever a file or a key keeps of it is the table itself.

Raises
------
ValueError
    If a table breaks one of these rules.

Notes
-----
f is divided by f(0), so that alpha is the erosion rate at the burr's centre, as with the other shapes.
Between points f^(1/k) is linear, f itself where k = 0: so f never leaves the range of the two values beside
it, and ends as (1 - x)^k. The last piece alone decides the law of small forces, v ~ F^(4 (k + 1)/3), and
bone is cut near the surface: points should be dense there.

Examples
--------
>>> import burrlab, numpy
>>> x = 1 - numpy.linspace(1, 0, 33) ** 2
>>> f = burrlab.Shape.from_table(x, lambda x: numpy.cos(numpy.pi / 2 * x))
>>> f.order, round(f(0.5), 4), f == burrlab.Shape(f.name)
(1.0, 0.7067, True)
)doc")
      .def_readonly("name", &Shape::name, "Name that gives the same shape to the bit.")
      .def_readonly("label", &Shape::label,
                    "The name; for a table its number of points, order and a digest of its name.")
      .def_readonly(
          "order", &Shape::order,
          "Order of the zero of f at x = 1: 0 for constant, 1 for linear, k for power(k) and tables.")
      .def(
          "__call__",
          [](const Shape& f, const py::array_t<double, py::array::forcecast>& x) {
            return py::vectorize([&f](double r) {
              if (!(r >= 0.0)) refuse("x", "r/R, zero or positive", r);
              return f.at_radius(r);
            })(x);
          },
          "x"_a, "f at x = r/R >= 0 (scalar or array); zero beyond 1.")
      .def(
          "__eq__", [](const Shape& a, const Shape& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Shape& f) { return py::hash(py::str(f.name())); })
      .def("__repr__", [](const Shape& f) { return "Shape('" + f.label() + "')"; })
      .def("__str__", &Shape::label)
      .def(py::pickle([](const Shape& f) { return f.name(); },
                      [](const std::string& name) { return Shape::parse(name); }));

  m.attr("shape_names") = py::tuple(py::cast(Shape::names()));  // apart from power(k)
  m.def("shape_kappa", &Shape::kappa, "shape"_a,
        "Factor of the leading term at the burr's surface: f = kappa (1 - x)^order + ...");
  m.def(
      "depth_table",
      [](double order) {
        const auto table = DepthTable::of_order(order);
        return to_array(table->nodes().data(), {DepthTable::rows, DepthTable::columns});
      },
      "order"_a,
      "G(e, tau) of the scheme `layer` at e = 0, 1/8 .. 3 (rows) and tau = 0, 1/40 .. 1 (columns), (25, 41) "
      "float32; a copy.");
}

/// Warns of constants that look swapped, or given in other units. The ranges are those of the shipped
/// materials, widened by 1.5 (as in a fit's diagnostics); 30 times beyond them is far (ours).
void doubt(double c_e, double alpha) {
  constexpr double stiff[] = {0.308, 3.2175}, fast[] = {0.058, 0.384}, far = 30;
  const auto within = [](double value, const double* range) {
    return range[0] <= value && value <= range[1];
  };
  const char* looks = nullptr;
  if (within(alpha, stiff) && within(c_e, fast) && !within(c_e, stiff))
    looks = "look swapped";
  else if (alpha > far * fast[1] || c_e > far * stiff[1] || c_e < stiff[0] / far)
    looks = "look like numbers of other units than N/mm^2 and 1/ms";
  if (looks)
    warn(format(
        "c_e = {:g} N/mm^2 and alpha = {:g} 1/ms {}: known materials have c_e 0.46 to 2.1 N/mm^2 and alpha "
        "0.087 to 0.26 1/ms",
        c_e, alpha, looks));
}

}  // namespace

void bind_material(py::module_& m) {
  bind_shape(m);
  Class<Burr>(m, "Burr", R"(A spherical burr.

Parameters
----------
radius : float
    R [mm]; surgical burrs have 1 to 5 mm.

Raises
------
ValueError
    If the radius is not positive and finite.

Examples
--------
>>> import burrlab
>>> burrlab.Burr(3.0)
Burr(radius=3.0)
)")
      .def(py::init([](const py::object& radius) {
             return Burr(argument<double>("radius", "a number [mm]", radius));
           }),
           "radius"_a)
      .def_readonly("radius", &Burr::radius, "R [mm]")
      .def(
          "__eq__", [](const Burr& a, const Burr& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const Burr& b) { return py::hash(py::float_(b.radius)); })
      .def("__repr__",
           [](const Burr& b) { return "Burr(radius=" + std::string(py::str(py::float_(b.radius))) + ")"; })
      .def(py::pickle([](const Burr& b) { return b.radius; }, [](double radius) { return Burr(radius); }));

  Class<Material>(m, "Material",
                  R"(A material: elastic constant, erosion rate, and the shape f that the rate belongs to.

Parameters
----------
name : str
c_e : float
    Elastic constant of Eq. 3 [N/mm^2].
alpha : float
    Erosion rate of Eq. 4 [1/ms], for one `shape`, drill, burr type and speed; at 1 N.
shape : Shape or str
    Erosion shape function f.
source : str
    Source of the numbers.
force_exponent : float
    q, 1 to 8, of the law F = c_e R^2 (h/R)^q; 3/2 in Eq. 3.
rate_exponent : float
    m, 0 to 8, of the rate alpha (F/1 N)^m; 0 in Eq. 4.

Raises
------
ValueError
    If c_e is not positive, alpha negative, one not finite, q not 1 to 8, m not 0 to 8, or the shape unknown.

Warns
-----
UserWarning
    If c_e and alpha look swapped, or as if in other units.

Notes
-----
The unit of c_e follows from F = c_e R^2 (h/R)^q. alpha is read per millisecond, the
haptic period. Both units are our decisions: the paper prints none.

Examples
--------
>>> import burrlab
>>> burrlab.Material("test block", c_e=2.0, alpha=0.1)
Material('test block', c_e=2.0, alpha=0.1, shape='parabolic', source='')
)")
      .def(py::init([](const py::object& name, const py::object& c_e, const py::object& alpha,
                       const py::object& shape, const py::object& source, const py::object& force_exponent,
                       const py::object& rate_exponent) {
             Material material(argument<py::str>("name", "text", name),
                               argument<double>("c_e", "a number [N/mm^2]", c_e),
                               argument<double>("alpha", "a number [1/ms]", alpha), to_shape(shape),
                               argument<py::str>("source", "text", source),
                               argument<double>("force_exponent", "a number", force_exponent),
                               argument<double>("rate_exponent", "a number", rate_exponent));
             doubt(material.c_e, material.alpha);
             return material;
           }),
           "name"_a = "unnamed", py::kw_only(), "c_e"_a, "alpha"_a, "shape"_a = "parabolic", "source"_a = "",
           "force_exponent"_a = Material::paper_force_exponent, "rate_exponent"_a = 0.0)
      .def_readonly("name", &Material::name)
      .def_readonly("c_e", &Material::c_e, "Elastic constant [N/mm^2]")
      .def_readonly("alpha", &Material::alpha, "Erosion rate [1/ms]")
      .def_readonly("shape", &Material::shape, "Erosion shape function")
      .def_readonly("source", &Material::source, "Source of the numbers")
      .def_readonly("force_exponent", &Material::force_exponent, "q of F = c_e R^2 (h/R)^q")
      .def_readonly("rate_exponent", &Material::rate_exponent, "m of the rate alpha (F/1 N)^m")
      .def(
          "__eq__", [](const Material& a, const Material& b) { return a == b; }, py::is_operator())
      .def("__hash__",
           [](const Material& a) {
             return py::hash(
                 py::make_tuple(a.name, a.c_e, a.alpha, a.shape.name(), a.force_exponent, a.rate_exponent));
           })
      .def("__repr__",
           [](const Material& a) {
             std::string law;  // where it is not the paper's
             if (a.force_exponent != Material::paper_force_exponent)
               law += format(", force_exponent={!r}", a.force_exponent);
             if (a.rate_exponent != 0.0) law += format(", rate_exponent={!r}", a.rate_exponent);
             return format("Material({!r}, c_e={!r}, alpha={!r}, shape={!r}, source={!r}{})", a.name, a.c_e,
                           a.alpha, a.shape.label(), a.source, law);
           })
      .def(py::pickle(
          [](const Material& a) {  // the keys of stores follow from it: the paper's law adds nothing
            const bool paper = a.force_exponent == Material::paper_force_exponent && a.rate_exponent == 0.0;
            const py::tuple law = paper ? py::tuple() : py::make_tuple(a.force_exponent, a.rate_exponent);
            return py::tuple(py::make_tuple(a.name, a.c_e, a.alpha, a.shape, a.source) + law);
          },
          [](const py::tuple& t) {
            const bool paper = t.size() == 5;
            return Material(t[0].cast<std::string>(), t[1].cast<double>(), t[2].cast<double>(),
                            t[3].cast<Shape>(), t[4].cast<std::string>(),
                            paper ? Material::paper_force_exponent : t[5].cast<double>(),
                            paper ? 0.0 : t[6].cast<double>());
          }));
  m.def("paper_materials", &paper_materials, "The four materials of the paper, with their source.");
}
