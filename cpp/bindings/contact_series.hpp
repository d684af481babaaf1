// What a path of contacts gives to Python.
#pragma once

#include <vector>

#include "bindings.hpp"
#include "burrlab/burr_contact.hpp"

/// Contacts of a whole path; columns are copied out as arrays.
struct ContactSeries {
  std::vector<burrlab::Contact> contacts;
};
