#include "burrlab/error.hpp"

namespace burrlab {

Error::~Error() = default;
const char* InvalidArgument::what() const noexcept { return invalid_argument::what(); }
const char* RuntimeError::what() const noexcept { return runtime_error::what(); }

const char* SystemError::what() const noexcept { return system_error::what(); }

}  // namespace burrlab
