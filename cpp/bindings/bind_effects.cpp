#ifndef _WIN32
#include <unistd.h>
#endif

#include <cstring>
#include <memory>

#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/effects/companion.hpp"
#include "burrlab/session/realtime.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

using Numbers = py::array_t<std::uint32_t, py::array::c_style>;
using Levels = py::array_t<std::uint8_t, py::array::c_style>;
using Places = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Decision = std::tuple<std::int64_t, std::int32_t, std::int32_t>;

py::array_t<ParcelView> to_array(const std::vector<ParcelView>& parcels) {
  py::array_t<ParcelView> out(static_cast<py::ssize_t>(parcels.size()));
  if (!parcels.empty())
    std::memcpy(static_cast<void*>(out.mutable_data()), parcels.data(), parcels.size() * sizeof(ParcelView));
  return out;
}

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
  py::dict out;
  out["frames"] = counts.frames;
  out["over_budget"] = counts.over_budget;
  out["coarse"] = counts.coarse;
  out["cut"] = counts.cut;
  out["crowded"] = counts.crowded;
  out["skipped"] = counts.skipped;
  out["merged"] = counts.merged;
  out["sub_steps_least"] = counts.least_sub_steps;
  out["sub_steps_most"] = counts.most_sub_steps;
  out["sub_steps_mean"] = counts.frames ? double(counts.sub_steps) / double(counts.frames) : 0.0;
  out["parcels_most"] = counts.most_parcels;
  out["wall_ms"] = times_of(wall);
  out["cpu_ms"] = times_of(cpu);
  return out;
}

EffectsSetup to_setup(const EffectParameters& parameters, std::uint64_t seed, const Vec3& down,
                      const Vec3& spin, std::optional<double> budget) {
  return {parameters, seed, down, spin, budget};
}

Decision step(Effects& effects, double seconds, const Numbers& bricks, const Levels& density,
              const Places& centers, const Places& radii, const std::optional<Decision>& given) {
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
  return {decision.merge_to, decision.sub_steps, decision.done};
}

int this_process() {
#ifdef _WIN32
  return 0;
#else
  return static_cast<int>(getpid());
#endif
}

/// A fork has a companion without its thread, whom nobody can wait for: it is left alone.
struct EndWhereMade {
  int process = this_process();
  void operator()(EffectsCompanion* companion) const {
    if (process == this_process()) delete companion;
  }
};
using OwnCompanion = std::unique_ptr<EffectsCompanion, EndWhereMade>;

void bind_companion(py::module_& m) {
  py::class_<EffectsCompanion, OwnCompanion>(
      m, "EffectsCompanion", "Effects in a thread beside a session or replica; see Companion.")
      .def(py::init([](const std::shared_ptr<HapticLoop>& loop, const std::shared_ptr<Follower>& follower,
                       const EffectParameters& parameters, std::uint64_t seed, const Vec3& down,
                       const Vec3& spin, std::optional<double> budget, double rate, bool realtime) {
             if (!loop || !follower) throw std::invalid_argument("loop and follower must be a session's");
             const py::gil_scoped_release release;
             return OwnCompanion(new EffectsCompanion(
                 feed_of(loop, follower), to_setup(parameters, seed, down, spin, budget), rate, realtime));
           }),
           py::arg("loop"), py::arg("follower"), py::kw_only(), py::arg("parameters"), py::arg("seed"),
           py::arg("down"), py::arg("spin"), py::arg("budget"), py::arg("rate"), py::arg("realtime"))
      .def(py::init([](const std::shared_ptr<Replica>& replica, const EffectParameters& parameters,
                       std::uint64_t seed, const Vec3& down, const Vec3& spin, std::optional<double> budget,
                       double rate, bool realtime) {
             if (!replica) throw std::invalid_argument("replica must be a Replica, got None");
             const py::gil_scoped_release release;
             return OwnCompanion(new EffectsCompanion(
                 feed_of(replica), to_setup(parameters, seed, down, spin, budget), rate, realtime));
           }),
           py::arg("replica"), py::kw_only(), py::arg("parameters"), py::arg("seed"), py::arg("down"),
           py::arg("spin"), py::arg("budget"), py::arg("rate"), py::arg("realtime"))
      .def("start", &EffectsCompanion::start, py::call_guard<py::gil_scoped_release>())
      .def("stop", &EffectsCompanion::stop, py::call_guard<py::gil_scoped_release>())
      .def("wait", &EffectsCompanion::wait, py::arg("seconds"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("running", &EffectsCompanion::running)
      .def_property_readonly("error", &EffectsCompanion::error)
      .def_property_readonly("realtime_notes", &EffectsCompanion::realtime_notes)
      .def("set_nozzle", &EffectsCompanion::set_nozzle, py::arg("nozzle"))
      .def("set_sucker", &EffectsCompanion::set_sucker, py::arg("sucker"))
      .def("set_camera", &EffectsCompanion::set_camera, py::arg("camera"))
      .def_property_readonly("quantum", &EffectsCompanion::quantum, "[mm^3]")
      .def_property_readonly("first_tick", &EffectsCompanion::first_tick)
      .def_property_readonly(
          "frames",
          [](const EffectsCompanion& companion) {
            std::vector<std::tuple<double, std::uint64_t, Decision>> out;
            for (const FrameRecord& f : companion.frames())
              out.emplace_back(f.seconds, f.tick,
                               Decision{f.decision.merge_to, f.decision.sub_steps, f.decision.done});
            return out;
          },
          "[(seconds, tick, decision)], one a frame")
      .def(
          "newest",
          [](const EffectsCompanion& companion) {
            EffectsFrame frame;
            {
              const py::gil_scoped_release release;
              frame = companion.newest();
            }
            py::dict out;
            out["frame"] = frame.frame;
            out["tick"] = frame.tick;
            out["parcels"] = to_array(frame.parcels);
            out["balance"] = to_dict(frame.balance);
            out["removed"] = frame.removed;
            out["bleeding"] = frame.bleeding;
            out["hidden"] = frame.hidden;
            out["report"] = to_dict(frame.counts, companion.wall_time(), companion.cpu_time());
            return out;
          },
          "What the newest frame left: frame, tick, parcels, balance, removed, bleeding, hidden, report.");
}

}  // namespace

void bind_effects(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(ParcelView, position, velocity, radius, dust, blood, water, age);
  m.attr("parcel_dtype") = py::dtype::of<ParcelView>();
  py::class_<Effects>(m, "Effects", "Dust, blood, water and a sucker; see burrlab.effects.Effects.")
      .def(py::init([](const VoxelBone& bone, const EffectParameters& parameters, std::uint64_t seed,
                       const Vec3& down, const Vec3& spin, std::optional<double> budget) {
             const EffectsSetup setup = to_setup(parameters, seed, down, spin, budget);
             const py::gil_scoped_release release;
             const VoxelBone::Reading reading(bone);
             return std::make_unique<Effects>(bone, setup);
           }),
           py::arg("bone"), py::kw_only(), py::arg("parameters"), py::arg("seed"), py::arg("down"),
           py::arg("spin"), py::arg("budget"))
      .def_property("nozzle", &Effects::nozzle, &Effects::set_nozzle)
      .def_property("sucker", &Effects::sucker, &Effects::set_sucker)
      .def("step", &step, py::arg("dt_s"), py::arg("bricks"), py::arg("density"), py::arg("centers"),
           py::arg("radii"), py::arg("decision"), "Returns the decision (merge_to, sub_steps, done).")
      .def(
          "parcels", [](const Effects& effects) { return to_array(effects.view()); }, "A copy.")
      .def(
          "balance", [](const Effects& effects) { return to_dict(effects.balance()); },
          "By substance (made, present, sucked, drained) [quanta].")
      .def_property_readonly("quantum", &Effects::quantum, "[mm^3]")
      .def_property_readonly("embedded", &Effects::embedded, "Parcels in solid voxels.")
      .def_property_readonly("refilled", &Effects::refilled, "Levels that rose.")
      .def_property_readonly(
          "removed", [](const Effects& effects) { return effects.sources().removed(); },
          "Levels by tissue's number; empty before any.")
      .def_property_readonly(
          "bleeding", [](const Effects& effects) { return effects.sources().bleeding(); }, "[mm^3/s]")
      .def_property_readonly(
          "decisions",
          [](const Effects& effects) {
            std::vector<Decision> out;
            for (const FrameDecision& d : effects.decisions())
              out.emplace_back(d.merge_to, d.sub_steps, d.done);
            return out;
          },
          "[(merge_to, sub_steps, done)], one a frame")
      .def(
          "hidden",
          [](const Effects& effects, const Camera& camera, const Vec3& center, double radius) {
            require_positive("radius of the burr", radius);
            for (int axis = 0; axis < 3; ++axis) require_finite("center of the burr", center[axis]);
            const py::gil_scoped_release release;
            return effects.hidden(camera, {center, radius});
          },
          py::arg("camera"), py::arg("center"), py::arg("radius"))
      .def("report", [](const Effects& effects) {
        return to_dict(effects.counts(), effects.wall_time(), effects.cpu_time());
      });
  bind_companion(m);
}
