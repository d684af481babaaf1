// Tick records as NumPy arrays.
#pragma once

#include <cstring>
#include <vector>

#include "bindings.hpp"
#include "burrlab/session/tick_record.hpp"

using Records = pybind11::array_t<burrlab::TickRecord, pybind11::array::c_style>;

/// A copy, (n,) of type record_dtype.
inline Records to_array(const std::vector<burrlab::TickRecord>& records) {
  Records out(static_cast<pybind11::ssize_t>(records.size()));
  if (!records.empty())
    std::memcpy(out.mutable_data(), records.data(), records.size() * sizeof(burrlab::TickRecord));
  return out;
}
