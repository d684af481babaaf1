// A minimal test framework: checks count, print where they fail, and go on.
#pragma once

#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>

namespace check {
inline int failures = 0;
inline int checks = 0;

inline void that(bool ok, const char* what, const char* file, int line) {
  ++checks;
  if (ok) return;
  ++failures;
  std::printf("%s:%d: failed: %s\n", file, line, what);
}

inline void near(double got, double want, double tolerance, const char* what, const char* file, int line) {
  ++checks;
  if (std::abs(got - want) <= tolerance) return;  // false for NaN
  ++failures;
  std::printf("%s:%d: failed: %s: got %.17g, want %.17g +- %g\n", file, line, what, got, want, tolerance);
}

template <class Function>
void throws(Function&& function, const std::string& part, const char* file, int line) {
  ++checks;
  try {
    function();
  } catch (const std::invalid_argument& error) {
    if (std::string(error.what()).find(part) != std::string::npos) return;
    std::printf("%s:%d: message '%s' lacks '%s'\n", file, line, error.what(), part.c_str());
    ++failures;
    return;
  }
  ++failures;
  std::printf("%s:%d: failed: no std::invalid_argument with '%s'\n", file, line, part.c_str());
}

inline int report() {
  std::printf("%d passed, %d failed\n", checks - failures, failures);
  return failures ? 1 : 0;
}
}  // namespace check

#define CHECK(condition) check::that((condition), #condition, __FILE__, __LINE__)
#define CHECK_NEAR(got, want, tolerance) check::near((got), (want), (tolerance), #got, __FILE__, __LINE__)
#define CHECK_THROWS(expression, part) check::throws([&] { (void)(expression); }, part, __FILE__, __LINE__)
