#include <algorithm>
#include <cstring>
#include <optional>

#include "bindings.hpp"
#include "burrlab/session/follower.hpp"
#include "burrlab/session/haptic_loop.hpp"
#include "burrlab/session/mailbox_device.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

using Records = py::array_t<TickRecord, py::array::c_style>;
using Tools = std::vector<std::pair<Burr, Material>>;

Records to_array(const std::vector<TickRecord>& records) {
  Records out(static_cast<py::ssize_t>(records.size()));
  if (!records.empty()) std::memcpy(out.mutable_data(), records.data(), records.size() * sizeof(TickRecord));
  return out;
}

std::vector<TickRecord> to_records(const py::array& array) {
  if (array.ndim() != 1 || !array.dtype().equal(py::dtype::of<TickRecord>()))
    throw std::invalid_argument("records must be an array of shape (n,) and type record_dtype, got " +
                                std::string(py::str(array.dtype())));
  const auto dense = Records::ensure(array);
  return {dense.data(), dense.data() + dense.size()};
}

std::shared_ptr<TickExecutor> make_executor(const std::shared_ptr<VoxelBone>& bone, const Tools& tools,
                                            std::uint64_t seed, double period, const std::string& scheme,
                                            std::uint64_t tick) {
  if (!bone) throw std::invalid_argument("bone must be a VoxelBone, got None");
  SessionSetup setup;
  for (const auto& [burr, material] : tools) setup.tools.push_back({burr, material});
  setup.seed = seed;
  setup.period = period;
  setup.scheme = parse_scheme(scheme);
  return std::make_shared<TickExecutor>(bone, setup, tick);
}

// Ticks in their order, checked before any is executed.
py::array execute(TickExecutor& executor, const py::array& array) {
  std::vector<TickRecord> records = to_records(array);
  for (std::size_t i = 0; i < records.size(); ++i) {
    check_record(records[i], executor.burrs());
    if (records[i].index != executor.tick() + i)
      refuse("index of a tick", "the next one, " + std::to_string(executor.tick() + i),
             double(records[i].index));
  }
  {
    const py::gil_scoped_release release;
    for (TickRecord& record : records) executor.execute(record);
  }
  return to_array(records);
}

/// A reader with the ring of its loop.
struct LoopReader {
  std::shared_ptr<HapticLoop> loop;  // kept alive
  std::shared_ptr<RecordReader> reader;
};

py::tuple take(LoopReader& self, std::size_t most) {
  std::vector<TickRecord> records;
  bool lost = false;
  {
    const py::gil_scoped_release release;
    records.resize(std::min<std::size_t>(most, self.reader->behind()));
    std::size_t n = 0;
    while (n < records.size()) {
      const auto result = self.reader->next(records[n]);
      if (result != RecordReader::Result::record) {
        lost = result == RecordReader::Result::lost;
        break;
      }
      ++n;
    }
    records.resize(n);
  }
  return py::make_tuple(to_array(records), lost);
}

py::array_t<double> to_array(const std::vector<double>& v) {
  return py::array_t<double>(static_cast<py::ssize_t>(v.size()), v.data());
}

void bind_loop(py::module_& m) {
  py::class_<LoopCounts>(m, "LoopCounts", "Counts since the start of a loop.")
      .def_readonly("ticks", &LoopCounts::ticks, "Executed")
      .def_readonly("late", &LoopCounts::late, "Ticks that stood for more than one period")
      .def_readonly("missed", &LoopCounts::missed, "Deadlines that had no tick of their own")
      .def_readonly("dropped", &LoopCounts::dropped, "Periods beyond 8 since a tick, that none stood for")
      .def("__repr__", [](const LoopCounts& c) {
        return std::string(py::str("LoopCounts(ticks={}, late={}, missed={}, dropped={})")
                               .format(c.ticks, c.late, c.missed, c.dropped));
      });

  py::class_<Histogram>(m, "Histogram", "Counts of durations [us], readable while they are counted.")
      .def_property_readonly("count", &Histogram::count, "Number of values")
      .def_property_readonly("largest", &Histogram::largest, "[us]")
      .def("quantile", &Histogram::quantile, py::arg("p"),
           "Value [us] below which a part p lies, at most 3 % too high; nan without values.")
      .def_property_readonly(
          "counts",
          [](const Histogram& h) {
            const auto counts = h.counts();
            return py::array_t<std::uint64_t>(static_cast<py::ssize_t>(counts.size()), counts.data());
          },
          "(n,) a bin; a copy")
      .def_property_readonly_static(
          "edges", [](const py::object&) { return to_array(Histogram::edges()); },
          "(n + 1,) of the bins [us]");

  py::class_<LoopReader>(m, "RecordReader", "One reader's place in a loop's ring of records.")
      .def(py::init([](const std::shared_ptr<HapticLoop>& loop) {
             auto reader = std::make_shared<RecordReader>(loop->ring());
             if (!loop->started()) loop->wait_for(reader);
             return LoopReader{loop, reader};
           }),
           py::arg("loop"))
      .def("take", &take, py::arg("most") = 100000,
           "(records, lost): up to `most` records that came since the last call, (n,) of type record_dtype; "
           "lost is True where the ring has gone past the next one.")
      .def_property_readonly(
          "behind", [](const LoopReader& r) { return r.reader->behind(); }, "Records not yet taken");

  const LoopSettings defaults;
  py::class_<HapticLoop, std::shared_ptr<HapticLoop>>(
      m, "HapticLoop",
      R"(The haptic loop: a thread that reads the devices, executes a tick and sends the force.

Parameters
----------
executor : TickExecutor
    Nothing else may touch its bone from `start` on.
devices : list of Device
    One a burr, in index order.
wall_clock : bool
    Keep absolute deadlines; else one period follows the other as fast as it goes, and results are the same on
    every machine.
realtime : bool
    Ask for real-time priority and locked memory; `realtime_notes` says what was granted.
cpu : int
    To stay on; -1 for any.
stall_limit : float
    Without a tick for so long the session stops, the force zero [ms].
ring : float
    Records kept for readers [s].
ticks : int
    End after so many; 0: when stopped.
force_limit : float
    Of the force sent, a burr [N].
slew_limit : float
    Of its change [N/ms].
coupling : float, optional
    Stiffness of a spring between device and burr [N/mm]; without it the burr is where the device is.

Raises
------
ValueError
    If there is not one device a burr, the rate is above 10 kHz, or a limit or the coupling is not positive.
)")
      .def(py::init([](std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
                       bool wall_clock, bool realtime, int cpu, double stall_limit, double ring,
                       std::uint64_t ticks, double force_limit, double slew_limit,
                       std::optional<double> coupling) {
             LoopSettings settings;
             settings.wall_clock = wall_clock;
             settings.realtime.priority = settings.realtime.lock_memory = realtime;
             settings.realtime.cpu = cpu;
             settings.stall_limit = stall_limit;
             settings.ring = ring;
             settings.ticks = ticks;
             settings.force_limit = force_limit;
             settings.slew_limit = slew_limit;
             if (coupling) require_positive("coupling", settings.coupling = *coupling);
             return std::make_shared<HapticLoop>(std::move(executor), std::move(devices), settings);
           }),
           py::arg("executor"), py::arg("devices"), py::kw_only(), py::arg("wall_clock") = true,
           py::arg("realtime") = true, py::arg("cpu") = -1, py::arg("stall_limit") = defaults.stall_limit,
           py::arg("ring") = defaults.ring, py::arg("ticks") = 0,
           py::arg("force_limit") = defaults.force_limit, py::arg("slew_limit") = defaults.slew_limit,
           py::arg("coupling") = py::none())
      .def("start", &HapticLoop::start, py::call_guard<py::gil_scoped_release>(),
           "Starts the thread; once. ValueError the second time.")
      .def("stop", &HapticLoop::stop, py::arg("reason") = "stopped", py::call_guard<py::gil_scoped_release>(),
           "Ends the session and waits for the thread.")
      .def("wait", &HapticLoop::wait, py::arg("seconds"), py::call_guard<py::gil_scoped_release>(),
           "Until the session ends; whether it has.")
      .def_property_readonly("running", &HapticLoop::running)
      .def_property_readonly("started", &HapticLoop::started)
      .def_property_readonly("reason", &HapticLoop::reason, "Why the session ended; empty while it runs")
      .def_property_readonly("failed", &HapticLoop::failed,
                             "It ended on a lost device, a stall or a value that is not finite")
      .def_property_readonly("realtime_notes", &HapticLoop::realtime_notes,
                             "What was asked of the system, and whether it was granted: a sentence each")
      .def_property_readonly("counts", &HapticLoop::counts)
      .def(
          "energy",
          [](const HapticLoop& loop, std::size_t burr) {
            const EnergyGiven e = loop.energy(burr);
            return py::make_tuple(e.now, e.most);
          },
          py::arg("burr") = 0,
          "(given to the hand minus taken from it, the largest so far) [mJ]: above zero the sampled force "
          "made it.")
      .def_property_readonly("jitter", &HapticLoop::jitter, py::return_value_policy::reference_internal,
                             "|time since the last tick - whole periods|")
      .def_property_readonly("lateness", &HapticLoop::lateness, py::return_value_policy::reference_internal,
                             "Start of a tick after its deadline")
      .def_property_readonly("tick_time", &HapticLoop::tick_time, py::return_value_policy::reference_internal,
                             "Of a tick on the thread's CPU clock")
      .def_property_readonly("wall_time", &HapticLoop::wall_time, py::return_value_policy::reference_internal,
                             "Of a tick on the wall clock")
      .def_property_readonly("executor", &HapticLoop::executor)
      .def_property_readonly("first_tick", &HapticLoop::first_tick, "Index of the first tick");
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
      .def("digest", &Follower::digest, py::call_guard<py::gil_scoped_release>(), "Of the bone now.")
      .def(
          "snapshot",
          [](const Follower& f) {
            std::uint64_t tick = 0;
            std::shared_ptr<VoxelBone> bone;
            {
              const py::gil_scoped_release release;
              bone = f.snapshot(tick);
            }
            return py::make_tuple(bone, tick);
          },
          "(copy of the bone, ticks it has seen)")
      .def("view", &Follower::view, "A consumer's own view: what changed since it last asked.")
      .def(
          "take",
          [](Follower& f, BoneView& view) {
            BoneView::Update update;
            {
              const py::gil_scoped_release release;
              update = view.take();
            }
            return to_dict(update, f.bone());
          },
          py::arg("view"),
          "tick (executed), newest (its record, or None), bricks (n, 3) (z, y, x) of 8^3 voxels that "
          "changed, density (n, 8, 8, 8).")
      .def("ask_rebuild", &Follower::ask_rebuild, "Rebuilds at its next turn, as if too far behind.");
}

}  // namespace

py::dict to_dict(const BoneView::Update& update, const VoxelBone& bone) {
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

void bind_session(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(BurrRecord, center, radius, material, on, touching, ambiguous, unused, force,
                       penetration, removed, sent, device_position, device_velocity, age);
  PYBIND11_NUMPY_DTYPE(TickRecord, index, k, burrs, time, cpu_time, burr);
  m.attr("record_dtype") = py::dtype::of<TickRecord>();
  m.attr("most_periods") = most_periods;

  py::class_<TickExecutor, std::shared_ptr<TickExecutor>>(
      m, "TickExecutor", R"(Tick records turned into force and erosion, the same wherever they are executed.

Parameters
----------
bone : VoxelBone
    Changed in place.
tools : list of (Burr, Material)
    One or two, in index order.
seed : int
period : float
    Of the loop [ms]; a tick stands for k = 1..8 of them.
scheme : {"layer", "cell"}
tick : int
    Number of ticks executed on this bone before.

Raises
------
ValueError
    If there are not one or two tools, the period is not positive, alpha times 8 periods is above 1000, or a burr
    does not fit the bone.
)")
      .def(py::init(&make_executor), py::arg("bone"), py::arg("tools"), py::arg("seed"), py::kw_only(),
           py::arg("period") = 1.0, py::arg("scheme") = "layer", py::arg("tick") = 0)
      .def("execute", &execute, py::arg("records"),
           R"(Executes ticks in their order.

Parameters
----------
records : ndarray, shape (n,), record_dtype
    Index, k, centres and switches are used.

Returns
-------
ndarray, shape (n,), record_dtype
    A copy with what the model gives: force, penetration, removed, touching, ambiguous.

Raises
------
ValueError
    If a record is not of this session or not the next one; nothing is executed then.
)")
      .def("probe", &TickExecutor::probe, py::arg("burr"), py::arg("center"),
           "The contact of a burr at a centre [mm] now, without erosion.")
      .def_property_readonly("tick", &TickExecutor::tick, "Index of the next tick")
      .def_property_readonly("bone", &TickExecutor::bone)
      .def_property_readonly("burrs", &TickExecutor::burrs)
      .def_property_readonly(
          "period", [](const TickExecutor& e) { return e.setup().period; }, "[ms]")
      .def_property_readonly("seed", [](const TickExecutor& e) { return e.setup().seed; });

  py::class_<Device, std::shared_ptr<Device>>(m, "Device", "What moves a burr and feels the force.")
      .def_property_readonly("name", &Device::name);
  py::class_<MailboxDevice, Device, std::shared_ptr<MailboxDevice>>(
      m, "MailboxDevice", R"(A device driven from Python, or any other thread, through a mailbox.

Parameters
----------
lost_after : float
    A position that old is lost, and the session stops [ms].
name : str
    For the session's report.

Raises
------
ValueError
    If `lost_after` is not positive.
)")
      .def(py::init([](double lost_after, const std::string& name) {
             return std::make_shared<MailboxDevice>(lost_after, name);
           }),
           py::kw_only(), py::arg("lost_after") = 100.0, py::arg("name") = "mailbox")
      .def("put", &MailboxDevice::put, py::arg("position"), py::arg("velocity") = Vec3::Zero().eval(),
           py::arg("on") = true,
           "Newest position (x, y, z) [mm], velocity [mm/s], and whether the burr turns. ValueError if not "
           "finite.")
      .def_property_readonly("force", &MailboxDevice::force, "(3,) that the loop sent last [N]; a copy");

  bind_loop(m);
  bind_follower(m);
}
