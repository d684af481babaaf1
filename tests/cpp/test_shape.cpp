// Erosion shape functions: values, names and refusals of the parser.
#include "burrlab/shape.hpp"

#include "check.hpp"

using burrlab::Shape;

int main() {
  CHECK_NEAR(Shape::parabolic().at_radius(0.5), 0.75, 1e-15);
  CHECK_NEAR(Shape::parse("linear").at_radius(0.25), 0.75, 0.0);
  CHECK_NEAR(Shape::parse("quartic").at_radius(0.5), 0.5625, 1e-15);
  CHECK_NEAR(Shape::parse("power(1.5)").at_radius(0.5), std::pow(0.75, 1.5), 1e-15);
  CHECK_NEAR(Shape::parse("power(3.0)").at_radius(0.5f), 0.421875f, 0.0);

  for (const char* name :
       {"constant", "linear", "parabolic", "quartic", "power(0.5)", "power(3)", "power(8)"}) {
    const Shape f = Shape::parse(name);
    CHECK(f.name() == name);
    CHECK(Shape::parse(f.name()) == f);
    CHECK(f.at_radius(0.0) == 1.0);
    CHECK(f.at_radius(1.0 + 1e-9) == 0.0);
    CHECK(f.at_depth(1.0) == 1.0);
    CHECK(f.at_depth(0.0) == (f.order() == 0.0 ? 1.0 : 0.0));
    for (double x = 0.0; x < 1.0; x += 1.0 / 16.0) {
      CHECK_NEAR(f.at_depth(1.0 - x), f.at_radius(x), 1e-14);
      CHECK(f.at_radius(x) >= f.at_radius(x + 1.0 / 16.0));
    }
  }

  CHECK(Shape::parse("constant").order() == 0.0 && Shape::parse("linear").order() == 1.0 &&
        Shape::parse("quartic").order() == 2.0);
  CHECK(Shape::parse("power(1)") == Shape::parabolic());
  CHECK(!(Shape::parse("linear") == Shape::parabolic()));  // one order, two functions
  CHECK(Shape::parse("power(0.33333333333333331)").name() == "power(0.3333333333333333)");

  for (const char* name :
       {"", "cubic", "Parabolic", "power", "power()", "power(1", "power(x)", "power(1,5)", "power(1 )"}) {
    CHECK_THROWS(Shape::parse(name), "shape must be parabolic, linear, quartic, constant or power(k), got '");
  }
  for (const char* name : {"power(0)", "power(-1)", "power(8.1)"}) {
    CHECK_THROWS(Shape::parse(name), "k of power(k) must be in (0, 8], got ");
  }
  return check::report();
}
