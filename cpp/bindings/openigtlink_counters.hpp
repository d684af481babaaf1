// Counters of OpenIGTLink messages as a dictionary of Python.
#pragma once

#include <map>
#include <string>

#include "burrlab/network/message_framer.hpp"

inline std::map<std::string, std::uint64_t> to_dict(const burrlab::openigtlink::Counters& counters) {
  using namespace burrlab::openigtlink;
  std::map<std::string, std::uint64_t> out{{"messages", counters.messages}};
  for (std::size_t i = 1; i < drop_reasons; ++i) out[drop_name(Drop(i))] = counters.dropped[i];
  return out;
}
