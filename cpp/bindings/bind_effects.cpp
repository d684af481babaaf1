#ifndef _WIN32
#include <unistd.h>
#endif

#include <memory>

#include "bindings.hpp"
#include "effects/companion.hpp"
#include "session/realtime.hpp"

namespace {

using Decision = std::tuple<std::int64_t, std::int32_t, std::int32_t>;

py::dict to_dict(const std::array<SubstanceBalance, substances>& balance) {
  py::dict out;
  for (int s = 0; s < substances; ++s) {
    const SubstanceBalance& b = balance[std::size_t(s)];
    out[substance_names[s]] = py::make_tuple(b.made, b.present, b.sucked, b.drained);
  }
  return out;
}

py::dict times_of(const Histogram& times) {
  py::dict out;
  for (const auto& [name, p] : {std::pair{"p50", 0.5}, {"p90", 0.9}, {"p99", 0.99}, {"p999", 0.999}})
    out[name] = 1e-3 * times.quantile(p);
  out["max"] = 1e-3 * times.largest();
  return out;
}

py::dict to_dict(const FrameCounts& counts, const Histogram& wall, const Histogram& cpu) {
  const double mean = counts.frames ? double(counts.sub_steps) / double(counts.frames) : 0.0;
  return py::dict("frames"_a = counts.frames, "over_budget"_a = counts.over_budget,
                  "coarse"_a = counts.coarse, "cut"_a = counts.cut, "crowded"_a = counts.crowded,
                  "skipped"_a = counts.skipped, "merged"_a = counts.merged,
                  "sub_steps_least"_a = counts.least_sub_steps, "sub_steps_most"_a = counts.most_sub_steps,
                  "sub_steps_mean"_a = mean, "parcels_most"_a = counts.most_parcels,
                  "wall_ms"_a = times_of(wall), "cpu_ms"_a = times_of(cpu));
}

Decision to_tuple(const FrameDecision& decision) {
  return {decision.merge_to, decision.sub_steps, decision.done};
}

Decision step(Effects& effects, double seconds, const Numbers& bricks, const LevelArray& density,
              const Reals& centers, const Reals& radii, const std::optional<Decision>& given) {
  if (bricks.ndim() != 1 || density.size() != bricks.size() * brick_voxels)
    throw std::invalid_argument("density must hold 512 levels a brick");
  if (centers.ndim() != 2 || centers.shape(1) != 3 || radii.ndim() != 1 || radii.shape(0) != centers.shape(0))
    throw std::invalid_argument("burrs must be (center, radius) each, the center (x, y, z)");
  std::vector<BurrAt> burrs;
  for (py::ssize_t i = 0; i < radii.shape(0); ++i)
    burrs.push_back({Vec3(centers.at(i, 0), centers.at(i, 1), centers.at(i, 2)), radii.at(i)});
  FrameDecision decision;
  if (given) decision = {std::get<0>(*given), std::get<1>(*given), std::get<2>(*given)};
  const BrickLevels changes{bricks.data(), density.data(), std::size_t(bricks.size())};
  const py::gil_scoped_release release;
  const std::int64_t begin = steady_now(), cpu = thread_cpu_now();
  decision = effects.step(seconds, changes, burrs, given ? &decision : nullptr, begin);
  effects.count_frame(1e-3 * double(steady_now() - begin), 1e-3 * double(thread_cpu_now() - cpu));
  return to_tuple(decision);
}

int this_process() {
#ifdef _WIN32
  return 0;
#else
  return static_cast<int>(getpid());
#endif
}

/// A forked process has a companion without its thread, which must not be waited for: it is not deleted.
struct EndWhereMade {
  int process = this_process();
  void operator()(EffectsCompanion* companion) const {
    if (process == this_process()) delete companion;
  }
};
using OwnCompanion = std::unique_ptr<EffectsCompanion, EndWhereMade>;

/// The constructor for what it follows: a loop and its follower, or a replica.
template <class... Followed>
auto companion_of() {
  return py::init([](const std::shared_ptr<Followed>&... followed, const EffectParameters& parameters,
                     std::uint64_t seed, const Vec3& down, const Vec3& spin, std::optional<double> budget,
                     double rate, bool realtime) {
    if (!(followed && ...))
      throw std::invalid_argument(sizeof...(followed) > 1 ? "loop and follower must be a session's"
                                                          : "replica must be a Replica, got None");
    const py::gil_scoped_release release;
    return OwnCompanion(new EffectsCompanion(
        feed_of(followed...), EffectsSetup{parameters, seed, down, spin, budget}, rate, realtime));
  });
}

void bind_companion(py::module_& m) {
  Class<EffectsCompanion, OwnCompanion>(m, "EffectsCompanion",
                                        "Effects in a thread beside a session or replica; see Companion.")
      .def(companion_of<HapticLoop, Follower>(), "loop"_a, "follower"_a, py::kw_only(), "parameters"_a,
           "seed"_a, "down"_a, "spin"_a, "budget"_a, "rate"_a, "realtime"_a)
      .def(companion_of<Replica>(), "replica"_a, py::kw_only(), "parameters"_a, "seed"_a, "down"_a, "spin"_a,
           "budget"_a, "rate"_a, "realtime"_a)
      .def(
          "start", [](EffectsCompanion& companion) { return companion.start(), &companion; },
          py::return_value_policy::reference, no_gil, "Starts the thread. ValueError the second time.")
      .def("stop", &EffectsCompanion::stop, no_gil)
      .def("wait", &EffectsCompanion::wait, "seconds"_a, no_gil)
      .def_readonly("running", &EffectsCompanion::running)
      .def_readonly("error", &EffectsCompanion::error, "The error that ended the thread; empty if none did.")
      .def_readonly(
          "realtime_notes", &EffectsCompanion::realtime_notes,
          "A sentence for each right asked of the system, granted or not; empty before the first frame.")
      .def("set_nozzle", &EffectsCompanion::set_nozzle, "nozzle"_a, "Sets it, from the next frame on.")
      .def("set_sucker", &EffectsCompanion::set_sucker, "sucker"_a, "Sets it, from the next frame on.")
      .def("set_camera", &EffectsCompanion::set_camera, "camera"_a, "Sets it, from the next frame on.")
      .def_readonly("quantum", &EffectsCompanion::quantum, "One level of one voxel [mm^3].")
      .def_readonly("first_tick", &EffectsCompanion::first_tick,
                    "Tick of the bone at the companion's beginning.")
      .def_readonly(
          "frames",
          [](const EffectsCompanion& companion) {
            std::vector<std::tuple<double, std::uint64_t, Decision>> out;
            for (const FrameRecord& f : companion.frames())
              out.emplace_back(f.seconds, f.tick, to_tuple(f.decision));
            return out;
          },
          "(seconds, tick, decision) of all frames so far; `effects_of(player, effects, frames=...)` repeats "
          "them.")
      .def(
          "newest",
          [](const EffectsCompanion& companion) {
            const EffectsFrame frame = without_gil([&] { return companion.newest(); });
            return py::dict("frame"_a = frame.frame, "tick"_a = frame.tick,
                            "parcels"_a = to_array(frame.parcels), "balance"_a = to_dict(frame.balance),
                            "removed"_a = frame.removed, "bleeding"_a = frame.bleeding,
                            "hidden"_a = frame.hidden,
                            "report"_a = to_dict(frame.counts, companion.wall_time(), companion.cpu_time()));
          },
          "The newest frame: frame, tick, parcels, balance, removed, bleeding, hidden, report.");
}

}  // namespace

void bind_effects(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(ParcelView, position, velocity, radius, dust, blood, water, age);
  Class<Effects>(m, "Effects", "Dust, blood, water and a sucker; see burrlab.effects.Effects.")
      .def(py::init([](const VoxelBone& bone, const EffectParameters& parameters, std::uint64_t seed,
                       const Vec3& down, const Vec3& spin, std::optional<double> budget) {
             const EffectsSetup setup{parameters, seed, down, spin, budget};
             const py::gil_scoped_release release;
             const VoxelBone::Reading reading(bone);
             return std::make_unique<Effects>(bone, setup);
           }),
           "bone"_a, py::kw_only(), "parameters"_a, "seed"_a, "down"_a, "spin"_a, "budget"_a)
      .def("make_frame", &step, "dt_s"_a, "bricks"_a, "density"_a, "centers"_a, "radii"_a, "decision"_a,
           "One frame; returns the decision (merge_to, sub_steps, done).")
      .def_readonly(
          "parcels",
          [](const Effects& effects) {
            std::vector<ParcelView> parcels;
            effects.view(parcels);
            return to_array(parcels);
          },
          "A copy of the parcels: position (3,) [mm], velocity (3,) [mm/s], radius [mm], dust, blood, water "
          "[quanta], age [s].")
      .def(
          "quanta", [](const Effects& effects) { return to_dict(effects.balance()); },
          "(made, present, sucked, drained) [quanta] by substance.")
      .def_readonly("quantum", &Effects::quantum, "One level of one voxel [mm^3].")
      .def_readonly(
          "removed", [](const Effects& effects) { return effects.sources().removed(); },
          "Levels removed since the beginning, by tissue number; one value without tissues; empty before any "
          "removal.")
      .def(
          "hidden_part",
          [](const Effects& effects, const Camera& camera, const Vec3& center, double radius) {
            require_positive("radius of the burr", radius);
            require_finite("center of the burr", center);
            const py::gil_scoped_release release;
            return effects.hidden(camera, {center, radius});
          },
          "camera"_a, "center"_a, "radius"_a)
      .def("counts",
           [](const Effects& effects) {
             return to_dict(effects.counts(), effects.wall_time(), effects.cpu_time());
           })
      .def_property("nozzle", &Effects::nozzle, &Effects::set_nozzle,
                    "A new one counts from the next frame on.")
      .def_property("sucker", &Effects::sucker, &Effects::set_sucker,
                    "A new one counts from the next frame on.");
  bind_companion(m);
}
