// All that the library offers. Units are mm, N and s, dt in ms and alpha in 1/ms; host_burr.hpp takes others.
//
//     #include <burrlab/burrlab.hpp>
//     #include <cstdio>
//
//     int main() {
//       const burrlab::Burr burr(3.0);
//       auto bone = std::make_shared<burrlab::VoxelBone>(burrlab::half_space(burr, 0.1, 1.0));
//       burrlab::BurrContact contact(bone, burr, burrlab::paper_material("bone"), 1);
//       const burrlab::Contact now = contact.step({0, 0, 2.7}, 1.0, true);
//       std::printf("%g N, %g mm^3\n", now.force.z(), now.removed);
//     }
#pragma once

#include "burrlab/anatomy/structure_distance.hpp"
#include "burrlab/bone_view.hpp"
#include "burrlab/burr_contact.hpp"
#include "burrlab/digest.hpp"
#include "burrlab/flat_file.hpp"
#include "burrlab/force.hpp"
#include "burrlab/host_burr.hpp"
#include "burrlab/material.hpp"
#include "burrlab/mean_field.hpp"
#include "burrlab/session/haptic_loop.hpp"
#include "burrlab/specimen.hpp"
#include "burrlab/tissues.hpp"
#include "burrlab/voxel_bone.hpp"
