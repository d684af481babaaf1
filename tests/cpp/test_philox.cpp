// Philox4x32 of 7 and of 10 rounds against the known-answer vectors published with Random123.
#include "philox.hpp"

#include "check.hpp"

using burrlab::philox4x32;
using burrlab::PhiloxBlock;

int main() {
  CHECK((philox4x32<10>({0, 0, 0, 0}, 0) == PhiloxBlock{0x6627e8d5u, 0xe169c58du, 0xbc57ac4cu, 0x9b00dbd8u}));
  CHECK((philox4x32<10>({0xffffffffu, 0xffffffffu, 0xffffffffu, 0xffffffffu}, 0xffffffffffffffffu) ==
         PhiloxBlock{0x408f276du, 0x41c83b0eu, 0xa20bc7c6u, 0x6d5451fdu}));
  // Digits of pi; the key's first word is its low half.
  CHECK((philox4x32<10>({0x243f6a88u, 0x85a308d3u, 0x13198a2eu, 0x03707344u}, 0x299f31d0a4093822u) ==
         PhiloxBlock{0xd16cfe09u, 0x94fdccebu, 0x5001e420u, 0x24126ea1u}));

  CHECK((philox4x32<7>({0, 0, 0, 0}, 0) == PhiloxBlock{0x5f6fb709u, 0x0d893f64u, 0x4f121f81u, 0x4f730a48u}));
  CHECK((philox4x32<7>({0xffffffffu, 0xffffffffu, 0xffffffffu, 0xffffffffu}, 0xffffffffffffffffu) ==
         PhiloxBlock{0x5207ddc2u, 0x45165e59u, 0x4d8ee751u, 0x8c52f662u}));
  CHECK((philox4x32<7>({0x243f6a88u, 0x85a308d3u, 0x13198a2eu, 0x03707344u}, 0x299f31d0a4093822u) ==
         PhiloxBlock{0x4dfccabau, 0x190a87f0u, 0xc47362bau, 0xb6b5242au}));
  return check::report();
}
