#include <algorithm>
#include <cstring>

#include "burrlab/session/follower.hpp"
#include "records.hpp"

namespace py = pybind11;
using namespace burrlab;

py::dict to_dict(const BoneUpdate& update, const VoxelBone& bone) {
  const auto n = static_cast<py::ssize_t>(update.bricks.size());
  py::array_t<std::int64_t> bricks({n, py::ssize_t{3}});
  for (py::ssize_t i = 0; i < n; ++i) {
    const Index3 at = bone.place(update.bricks[std::size_t(i)]);
    std::copy(at.begin(), at.end(), bricks.mutable_data(i, 0));
  }
  py::array_t<std::uint8_t> density({n, py::ssize_t{8}, py::ssize_t{8}, py::ssize_t{8}});
  if (n) std::memcpy(density.mutable_data(), update.density.data(), update.density.size());
  py::dict out;
  out["tick"] = update.tick;
  out["newest"] = update.any ? py::object(to_array(std::vector<TickRecord>{update.newest})[py::int_(0)])
                             : py::object(py::none());
  out["bricks"] = bricks;
  out["density"] = density;
  return out;
}

void bind_follower(py::module_& m) {
  py::class_<BoneView, std::shared_ptr<BoneView>>(m, "BoneView", "What one consumer has not seen yet.");
  const FollowerSettings defaults;
  py::class_<Follower, std::shared_ptr<Follower>>(
      m, "Follower",
      R"(Executes a loop's ticks again on a bone of its own, and serves all that looks at the bone.

Parameters
----------
loop : HapticLoop
    Not yet started.
digest_every : int
    Ticks between digests.
stiffness_every : float
    Between measurements of the contact stiffness [ms].
rebuild_after : float
    Further behind than this it takes the loop's bone over, between two ticks [s].
)")
      .def(py::init([](std::shared_ptr<HapticLoop> loop, std::uint64_t digest_every, double stiffness_every,
                       double rebuild_after) {
             if (!loop) throw std::invalid_argument("loop must be a HapticLoop, got None");
             return std::make_shared<Follower>(
                 std::move(loop), FollowerSettings{digest_every, stiffness_every, rebuild_after});
           }),
           py::arg("loop"), py::kw_only(), py::arg("digest_every") = defaults.digest_every,
           py::arg("stiffness_every") = defaults.stiffness_every,
           py::arg("rebuild_after") = defaults.rebuild_after)
      .def("start", &Follower::start, py::call_guard<py::gil_scoped_release>())
      .def("stop", &Follower::stop, py::call_guard<py::gil_scoped_release>(),
           "Waits for the loop's end, executes what is left, and ends.")
      .def_property_readonly(
          "status",
          [](const Follower& f) {
            FollowerStatus s;
            {
              const py::gil_scoped_release release;
              s = f.status();
            }
            py::dict out;
            out["tick"] = s.tick;
            out["behind"] = s.behind;
            out["most_behind_s"] = s.most_behind;
            out["rebuilds"] = s.rebuilds;
            out["differing"] = s.differing;
            out["first_difference"] = s.first_difference;
            return out;
          },
          "tick, behind [ticks], most_behind_s, rebuilds, differing (ticks that gave something else than the "
          "loop's), first_difference")
      .def_property_readonly(
          "digests",
          [](const Follower& f) {
            py::list out;
            for (const DigestAt& at : f.digests()) out.append(py::make_tuple(at.tick, at.digest));
            return out;
          },
          "[(ticks executed, digest)]")
      .def(
          "stiffness",
          [](const Follower& f, std::size_t burr) {
            const StiffnessAt s = f.stiffness(burr);
            return py::make_tuple(s.tick, s.stiffness, s.force);
          },
          py::arg("burr") = 0, "(tick, k = dF/dH along the normal [N/mm], force [N]) measured last.")
      .def(
          "stability",
          [](const Follower& f, std::size_t burr) {
            const StabilityReport r = f.stability(burr);
            py::dict out;
            out["force_N"] = r.force;
            out["stiffness_N_per_mm"] = r.k;
            out["limit_N_per_mm"] = r.limit;
            out["ratio"] = r.ratio;
            out["force_at_limit_N"] = r.force_at_limit;
            out["warning"] = r.warning;
            return out;
          },
          py::arg("burr") = 0,
          "The stiffness measured last against the passivity limit of the burr's device: force_N, "
          "stiffness_N_per_mm, limit_N_per_mm, ratio (of the stiffest direction), force_at_limit_N (below it "
          "the limit is exceeded in "
          "this "
          "hole), warning (ratio above 0.8); nan where the device does not say its damping.")
      .def(
          "digests_since",
          [](const Follower& f, std::size_t known) {
            std::vector<DigestAt> digests;
            {
              const py::gil_scoped_release release;
              digests = f.digests(known);
            }
            py::list out;
            for (const DigestAt& at : digests) out.append(py::make_tuple(at.tick, at.digest));
            return out;
          },
          py::arg("known"), "`digests` without the first `known`.")
      .def("digest", &Follower::digest, py::call_guard<py::gil_scoped_release>(), "Of the bone now.")
      .def("snapshot", &snapshot_of<Follower>, "(copy of the bone, ticks it has seen)")
      .def("view", &Follower::view, py::keep_alive<0, 1>(),
           "A consumer's own view: what changed since it last asked.")
      .def(
          "take",
          [](Follower& f, BoneView& view) {
            if (!view.is_of(f)) throw std::invalid_argument("view must be one of this follower");
            BoneUpdate update;
            {
              const py::gil_scoped_release release;
              update = view.take();
            }
            return to_dict(update, f.bone());
          },
          py::arg("view"),
          "tick (executed), newest (its record, or None), bricks (n, 3) (z, y, x) of 8^3 voxels that "
          "changed, density (n, 8, 8, 8).")
      .def(
          "set_watch",
          [](Follower& f, std::shared_ptr<AnatomyWatch> watch) {
            const py::gil_scoped_release release;
            f.visit([&](FollowedBone& followed) { followed.executor().set_watch(std::move(watch)); });
          },
          py::arg("watch"),
          "Watches the follower's bone from now on. ValueError unless it is of this bone and these burrs.")
      .def("watched", &watched_by<Follower>, py::arg("known") = 0,
           "What the watch has seen, as `AnatomyWatch.seen`. ValueError if there is none.")
      .def(
          "tissue_levels",
          [](Follower& f) {
            std::vector<std::int64_t> levels;
            {
              const py::gil_scoped_release release;
              f.visit([&](FollowedBone& followed) {
                const VoxelBone& bone = followed.bone();
                for (std::size_t i = 0; bone.tissues() && i < bone.tissues()->table().size(); ++i)
                  levels.push_back(bone.tissue_levels(i));
              });
            }
            return levels;
          },
          "Levels that are left of each tissue now, a list; empty without tissues.")
      .def("ask_rebuild", &Follower::ask_rebuild, "Rebuilds at its next turn, as if too far behind.");
}
