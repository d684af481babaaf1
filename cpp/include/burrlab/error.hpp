// What crosses the library's border: its visible symbols and its errors.
//
//     try {
//       burrlab::Burr burr(-1.0);
//     } catch (const burrlab::Error& error) {
//       std::puts(error.what());  // radius must be positive and finite, got -1
//     }
#pragma once

#include <stdexcept>
#include <string>
#include <system_error>

// Symbols are hidden but for those with this mark, in a shared library, which is built and used with
// BURRLAB_SHARED: the CMake target and pkg-config set it. A plug-in with the static library shows none of
// them.
#if defined(_WIN32) && defined(BURRLAB_SHARED)
#ifdef burrlab_EXPORTS
#define BURRLAB_API __declspec(dllexport)
#else
#define BURRLAB_API __declspec(dllimport)
#endif
#elif defined(BURRLAB_SHARED)
#define BURRLAB_API __attribute__((visibility("default")))
#else
#define BURRLAB_API
#endif

namespace burrlab {

/// Base of the library's errors. Each is a standard exception, too; only std::bad_alloc is that alone.
class BURRLAB_API Error {
 public:
  virtual ~Error();
  virtual const char* what() const noexcept = 0;  ///< one sentence: what, the rule, what came
};

/// An argument that breaks a rule, or an action that the state does not allow.
class BURRLAB_API InvalidArgument : public std::invalid_argument, public Error {
 public:
  /// With the sentence that `what` gives.
  explicit InvalidArgument(const std::string& sentence) : invalid_argument(sentence) {}
  const char* what() const noexcept override;  ///< the sentence
};

/// The system refused something.
class BURRLAB_API RuntimeError : public std::runtime_error, public Error {
 public:
  /// With the sentence that `what` gives.
  explicit RuntimeError(const std::string& sentence) : runtime_error(sentence) {}
  const char* what() const noexcept override;  ///< the sentence
};

/// The system cannot read or write a file, or a new one exists already.
class BURRLAB_API SystemError : public std::system_error, public Error {
 public:
  /// With the code, and the path in the sentence.
  SystemError(std::error_code code, const std::string& path) : system_error(code, path) {}
  const char* what() const noexcept override;  ///< path and reason
};

}  // namespace burrlab
