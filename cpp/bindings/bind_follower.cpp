#include <algorithm>

#include "bindings.hpp"

py::dict to_dict(const BoneUpdate& update, const VoxelBone& bone) {
  const auto n = static_cast<py::ssize_t>(update.changes.bricks.size());
  py::array_t<std::int64_t> bricks({n, py::ssize_t{3}});
  for (py::ssize_t i = 0; i < n; ++i) {
    const Index3 at = bone.place(update.changes.bricks[std::size_t(i)]);
    std::copy(at.begin(), at.end(), bricks.mutable_data(i, 0));
  }
  py::object newest = py::none();
  if (update.newest) newest = to_array(&*update.newest, {1})[py::int_(0)];
  return py::dict("tick"_a = update.tick, "newest"_a = newest, "bricks"_a = bricks,
                  "density"_a = to_array(update.changes.levels.data(), {n, 8, 8, 8}));
}

static py::list digests(const Follower& follower, std::size_t known) {
  py::list out;
  for (const DigestAt& at : without_gil([&] { return follower.digests(known); }))
    out.append(py::make_tuple(at.tick, at.digest));
  return out;
}

void bind_follower(py::module_& m) {
  Class<BoneView>(m, "BoneView", "The changes one consumer has not seen yet.");
  const FollowerSettings defaults;
  Class<Follower, std::shared_ptr<Follower>>(
      m, "Follower",
      "Executes a loop's ticks again on its own bone, for all that need to see the bone. The loop must not "
      "be started yet. `digest_every` [ticks]; `stiffness_every` [ms]; further behind than `rebuild_after` "
      "[s], it copies the loop's bone between two ticks.")
      .def(py::init([](std::shared_ptr<HapticLoop> loop, std::uint64_t digest_every, double stiffness_every,
                       double rebuild_after) {
             if (!loop) throw std::invalid_argument("loop must be a HapticLoop, got None");
             return std::make_shared<Follower>(
                 std::move(loop), FollowerSettings{digest_every, stiffness_every, rebuild_after});
           }),
           "loop"_a, py::kw_only(), "digest_every"_a = defaults.digest_every,
           "stiffness_every"_a = defaults.stiffness_every, "rebuild_after"_a = defaults.rebuild_after)
      .def("start", &Follower::start, no_gil)
      .def("stop", &Follower::stop, no_gil, "Waits for the loop's end, executes what is left, and ends.")
      .def_readonly(
          "status",
          [](const Follower& f) {
            const FollowerStatus s = without_gil([&] { return f.status(); });
            return py::dict("tick"_a = s.tick, "behind"_a = s.behind, "most_behind_s"_a = s.most_behind,
                            "rebuilds"_a = s.rebuilds, "differing"_a = s.differing,
                            "first_difference"_a = s.first_difference);
          },
          "A dict: tick, behind [ticks], most_behind_s, rebuilds, differing (ticks whose results differ from "
          "the loop's), first_difference")
      .def_readonly(
          "digests", [](const Follower& f) { return digests(f, 0); }, "[(ticks executed, digest)]")
      .def(
          "stiffness",
          [](const Follower& f, std::size_t burr) {
            const StiffnessAt s = f.stiffness(burr);
            return py::make_tuple(s.tick, s.stiffness, s.force);
          },
          "burr"_a = 0, "(tick, k = dF/dH along the normal [N/mm], force [N]), last measured.")
      .def(
          "stability",
          [](const Follower& f, std::size_t burr) {
            const StabilityReport r = f.stability(burr);
            return py::dict("force_N"_a = r.force, "stiffness_N_per_mm"_a = r.k, "limit_N_per_mm"_a = r.limit,
                            "ratio"_a = r.ratio, "force_at_limit_N"_a = r.force_at_limit,
                            "exceeded"_a = r.stiffer_above ? "above" : "below", "warning"_a = r.warning,
                            "delay_ms"_a = r.delay);
          },
          "burr"_a = 0,
          "The last stiffness against the passivity limit of the burr's device: force_N, stiffness_N_per_mm, "
          "limit_N_per_mm, ratio (of the stiffest direction), force_at_limit_N (the limit is exceeded below "
          "it in this hole; above it for a force exponent of 2 or more: exceeded), warning (ratio above "
          "0.8); nan if the device does not tell its damping. "
          "delay_ms, from a position to the middle of the time in which its force acts.")
      .def("digests_since", &digests, "known"_a, "`digests` without the first `known`.")
      .def("digest", &Follower::digest, no_gil, "Of the present bone.")
      .def("snapshot", &snapshot_of<Follower>, "(copy of the bone, ticks executed on it)")
      .def("view", &Follower::view, "A view for a new consumer, for `take`.")
      .def(
          "take",
          [](Follower& f, BoneView& view) {
            return to_dict(without_gil([&] { return f.take_changed(view); }), f.bone());
          },
          "view"_a,
          "Changes since the view was last taken: tick (executed), newest (its record, or None), bricks (n, "
          "3) (z, y, x) of 8^3 voxels, density (n, 8, 8, 8).")
      .def(
          "set_watch",
          [](Follower& f, std::shared_ptr<AnatomyWatch> watch) {
            const py::gil_scoped_release release;
            f.visit([&](FollowedBone& followed) { followed.executor().set_watch(std::move(watch)); });
          },
          "watch"_a,
          "Watches the follower's bone from now on. ValueError if the watch has another bone or other burrs.")
      .def("watched", &watched_by<Follower>, "known"_a = 0,
           "As `AnatomyWatch.seen`. ValueError without a watch.")
      .def(
          "tissue_levels",
          [](Follower& f) {
            const py::gil_scoped_release release;
            return f.visit([](FollowedBone& followed) { return followed.bone().tissue_levels(); });
          },
          "Levels left of each tissue, a list; empty without tissues.")
      .def("ask_rebuild", &Follower::ask_rebuild,
           "Rebuilds at the next turn, as if too far behind; for tests.");
}
