#include <algorithm>

#include "bindings.hpp"
#include "burrlab/flat_file.hpp"
#include "session/mailbox_device.hpp"

SessionSetup to_setup(const Tools& tools, std::uint64_t seed, double period, const std::string& scheme) {
  SessionSetup setup{{}, seed, period, parse_scheme(scheme)};
  for (const auto& [burr, material] : tools) setup.tools.push_back({burr, material});
  return setup;
}

namespace {

using Records = py::array_t<TickRecord, py::array::c_style>;

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
  return std::make_shared<TickExecutor>(bone, to_setup(tools, seed, period, scheme), tick);
}

// Executes ticks in order; all are checked first.
py::array execute(TickExecutor& executor, const py::array& array) {
  std::vector<TickRecord> records = to_records(array);
  const VoxelBone::Changing changing(*executor.bone());
  for (std::size_t i = 0; i < records.size(); ++i) {
    check_record(records[i], executor.burrs());
    if (records[i].index != executor.tick() + i)
      refuse("index of a tick", "the next one, " + std::to_string(executor.tick() + i),
             double(records[i].index));
  }
  without_gil([&] {
    for (TickRecord& record : records) executor.execute(record);
  });
  return to_array(records);
}

void bind_executor(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(BurrRecord, center, radius, material, on, touching, ambiguous, buttons, force,
                       penetration, removed, sent, device_position, device_velocity, age, orientation);
  PYBIND11_NUMPY_DTYPE(TickRecord, index, k, burrs, time, cpu_time, burr);
  m.attr("record_dtype") = py::dtype::of<TickRecord>();

  Class<TickExecutor, std::shared_ptr<TickExecutor>>(
      m, "TickExecutor",
      "Executes tick records: force and erosion, the same for all that execute them. The bone is changed in "
      "place. `tools` are one or two, in index order; `period` of the loop [ms], of which a tick stands for "
      "k = 1..8; `tick`: ticks executed on the bone before. ValueError if there are not one or two tools, "
      "the period is not positive, alpha times 8 periods is above 1000, or a burr does not fit the bone.")
      .def(py::init(&make_executor), "bone"_a, "tools"_a, "seed"_a, py::kw_only(), "period"_a = 1.0,
           "scheme"_a = "layer", "tick"_a = 0)
      .def("execute", &execute, "records"_a,
           "Executes ticks in order, records (n,) record_dtype; uses index, k, centres and switches. Returns "
           "a copy with the results: force, penetration, removed, touching, ambiguous. ValueError if a "
           "record is not of this session or not the next one; nothing is executed then.")
      .def("set_watch", &TickExecutor::set_watch, "watch"_a,
           "Sets the watch, called after each burr's step; it begins with the bone as it is. ValueError if "
           "the watch has another bone or other burrs.")
      .def(
          "probe",
          [](const TickExecutor& executor, std::size_t burr, const Vec3& center) {
            const VoxelBone::Reading reading(*executor.bone());
            return executor.probe(burr, center);
          },
          "burr"_a, "center"_a, "The contact of a burr at a centre [mm], without erosion.")
      .def_readonly("tick", &TickExecutor::tick, "Index of the next tick")
      .def_readonly("bone", &TickExecutor::bone);

  Class<Device, std::shared_ptr<Device>>(m, "Device", "A device that moves a burr and feels its force.")
      .def_readonly("name", &Device::name)
      .def_static("__init_subclass__", [](const py::kwargs&) {
        PyErr_SetString(
            PyExc_NotImplementedError,
            "Device cannot be subclassed in Python, which is too slow for a tick: put positions into a "
            "MailboxDevice, or give them to a ScriptedDevice or a ReplayDevice");
        throw py::error_already_set();
      });
  Class<MailboxDevice, Device, std::shared_ptr<MailboxDevice>>(
      m, "MailboxDevice", R"(A device driven from Python, or any other thread, through a mailbox.

Parameters
----------
lost_after : float
    Age at which a position is lost, and the session stops [ms].
name : str
    For the session's report.

Raises
------
ValueError
    If `lost_after` is not positive.
)")
      .def(py::init<double, const std::string&>(), py::kw_only(), "lost_after"_a = 100.0,
           "name"_a = "mailbox")
      .def(
          "put", &MailboxDevice::put, "position"_a, "velocity"_a = Vec3::Zero().eval(), "on"_a = true,
          "orientation"_a = DeviceReading().orientation, "buttons"_a = std::uint8_t(0),
          "Sets the newest position (x, y, z) [mm], velocity [mm/s], switch, orientation and buttons. The "
          "orientation is a unit quaternion (w, x, y, z) that turns directions of the tool into those of the "
          "bone; bit i of the buttons is button i. ValueError if a number is not finite, or the quaternion "
          "not of length 1.")
      .def("fail", &MailboxDevice::fail, "reason"_a,
           "Ends a session with this reason, and force zero. The device cannot serve another one; the first "
           "reason counts.")
      .def_readonly("fault", &MailboxDevice::fault, "The reason given to `fail`; empty without one")
      .def_readonly("force", &MailboxDevice::force, "(3,) last sent by the loop [N]; a copy")
      .def_static("__init_subclass__", [](const py::kwargs&) {});  // allowed: its `read` stays in C++
}

py::tuple take(RecordReader& reader, std::size_t most) {
  std::vector<TickRecord> records;
  auto result = RecordReader::Result::record;
  without_gil([&] {
    records.resize(std::min<std::size_t>(most, reader.behind()));
    std::size_t n = 0;
    while (n < records.size() && (result = reader.next(records[n])) == RecordReader::Result::record) ++n;
    records.resize(n);
  });
  return py::make_tuple(to_array(records), result == RecordReader::Result::lost);
}

void bind_counts(py::module_& m) {
  Class<LoopCounts>(m, "LoopCounts", "Counts since the start of a loop.")
      .def_readonly("ticks", &LoopCounts::ticks, "Executed")
      .def_readonly("late", &LoopCounts::late, "Ticks that stood for more than one period")
      .def_readonly("missed", &LoopCounts::missed, "Deadlines without a tick")
      .def_readonly("dropped", &LoopCounts::dropped, "Periods beyond 8 since a tick, for which none stood");

  Class<Histogram>(m, "Histogram", "Counts of durations [us], readable while they are counted.")
      .def_readonly("count", &Histogram::count, "Number of values")
      .def_readonly("largest", &Histogram::largest, "[us]")
      .def("quantile", &Histogram::quantile, "p"_a,
           "Value [us] below which a part p lies, at most 3 % too high; nan without values.")
      .def_readonly(
          "counts", [](const Histogram& h) { return to_array(h.counts()); }, "(n,) by bin; a copy")
      .def_property_readonly_static(
          "edges", [](const py::object&) { return to_array(Histogram::edges()); },
          "(n + 1,) of the bins [us]");
}

// The parts of LoopSettings that Python makes one a burr.
void bind_loop_settings(py::module_& m) {
  Class<GuardLimits>(m, "GuardLimits", "Of one burr's force [N], [N/ms], [N], [s], [s].")
      .def(py::init<double, double, double, double, double>(), py::kw_only(), "force"_a, "slew"_a,
           "continuous"_a, "window"_a, "ramp"_a)
      .def_readonly("force", &GuardLimits::force)
      .def_readonly("slew", &GuardLimits::slew)
      .def_readonly("continuous", &GuardLimits::continuous)
      .def_readonly("window", &GuardLimits::window)
      .def_readonly("ramp", &GuardLimits::ramp);
  Class<DeviceModel>(m, "DeviceModel", "Damping [N s/m], encoder step [mm] and friction [N]; nan: unknown.")
      .def(py::init<double, double, double>(), py::kw_only(), "damping"_a, "encoder_step"_a, "friction"_a);
  Class<DeviceFrame>(m, "LoopFrame", "See `burrlab.DeviceFrame`; clutch -1: none.")
      .def(py::init<double, const Quaternion&, const Vec3&, int>(), py::kw_only(), "scale"_a, "rotation"_a,
           "offset"_a, "clutch"_a);
}

void bind_haptic_loop(py::module_& m) {
  Class<RecordReader, std::shared_ptr<RecordReader>>(m, "RecordReader",
                                                     "One reader's place in a loop's ring of records.")
      .def(py::init([](const std::shared_ptr<HapticLoop>& loop) {
             if (!loop) throw std::invalid_argument("loop must be a HapticLoop, got None");
             auto reader = std::make_shared<RecordReader>(loop->ring());
             if (!loop->started()) loop->add_reader(reader);
             return reader;
           }),
           "loop"_a, py::keep_alive<1, 2>())
      .def("take", &take, "most"_a = 100000,
           "(records, lost): at most `most` records since the last call, (n,) record_dtype; lost is True if "
           "the ring has overwritten the next one.");

  const LoopSettings defaults;
  Class<HapticLoop, std::shared_ptr<HapticLoop>>(
      m, "HapticLoop",
      "The haptic loop: a thread that reads the devices, executes a tick and sends the force. It holds the "
      "executor's bone from `start` to its end; `devices` are one per burr, in index order. The settings are "
      "those of loop_settings.hpp. ValueError if there is not one device per burr, the rate is above 10 kHz "
      "or, on the wall clock, below 2 per `stall_limit`, a limit or the coupling is not positive, or a frame "
      "is none.")
      .def(py::init([](std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
                       bool wall_clock, bool realtime, int cpu, double stall_limit, double ring,
                       std::uint64_t ticks, double force_limit, double slew_limit,
                       std::optional<double> coupling, const std::vector<GuardLimits>& guards,
                       const std::vector<DeviceModel>& models, double stop_force, std::uint32_t stop_buttons,
                       const std::vector<DeviceFrame>& frames) {
             if (!executor) throw std::invalid_argument("executor must be a TickExecutor, got None");
             if (cpu < -1) refuse("cpu", "-1 or the number of a CPU", cpu);
             LoopSettings settings{wall_clock, {}, stall_limit, ring, ticks, {force_limit, slew_limit}};
             settings.guards = guards;
             settings.models = models;
             settings.frames = frames;
             settings.stop_force = stop_force;
             settings.stop_buttons = stop_buttons;
             settings.realtime.priority = settings.realtime.lock_memory = realtime;
             settings.realtime.cpu = cpu;
             if (coupling) require_positive("coupling", settings.coupling = *coupling);
             return std::make_shared<HapticLoop>(std::move(executor), std::move(devices), settings);
           }),
           "executor"_a, "devices"_a, py::kw_only(), "wall_clock"_a = true, "realtime"_a = true, "cpu"_a = -1,
           "stall_limit"_a = defaults.stall_limit, "ring"_a = defaults.ring, "ticks"_a = 0,
           "force_limit"_a = defaults.guard.force, "slew_limit"_a = defaults.guard.slew,
           "coupling"_a = py::none(), "guards"_a = py::list(), "models"_a = py::list(),
           "stop_force"_a = defaults.stop_force, "stop_buttons"_a = 0, "frames"_a = py::list())
      .def("start", &HapticLoop::start, no_gil,
           "Starts the thread. ValueError the second time, or if the bone or a device is in use.")
      .def("stop", &HapticLoop::stop, "reason"_a = "stopped", no_gil,
           "Ends the session and waits for the thread.")
      .def("wait", &HapticLoop::wait, "seconds"_a, no_gil,
           "Waits for the session's end; returns whether it came.")
      .def_readonly("running", &HapticLoop::running)
      .def_readonly("started", &HapticLoop::started)
      .def_readonly("reason", &HapticLoop::reason, "Why the session ended; empty while it runs")
      .def_readonly("failed", &HapticLoop::failed,
                    "It ended on a lost device, a stall or a value that is not finite")
      .def_readonly("realtime_notes", &HapticLoop::realtime_notes,
                    "What was asked of the system and granted, one sentence each")
      .def_readonly("counts", &HapticLoop::counts)
      .def(
          "energy",
          [](const HapticLoop& loop, std::size_t burr) {
            const EnergyGiven e = loop.energy(burr);
            return py::make_tuple(e.now, e.most);
          },
          "burr"_a = 0,
          "(energy given to the hand minus taken from it, its largest value so far) [mJ]; above zero, "
          "sampling or an edge of the bone made it.")
      .def_readonly("jitter", &HapticLoop::jitter, "|time since the last tick - whole periods|")
      .def_readonly("lateness", &HapticLoop::lateness, "Start of a tick after its deadline")
      .def_readonly("tick_time", &HapticLoop::tick_time, "CPU time of a tick")
      .def_readonly("wall_time", &HapticLoop::wall_time, "Wall time of a tick");
}

void bind_flat_file(py::module_& m) {
  m.def(
      "read_flat_bone",
      [](const std::string& path) {
        std::uint64_t tick = 0;
        std::string source;
        const auto bone =
            without_gil([&] { return std::make_shared<VoxelBone>(read_bone(path, &tick, &source)); });
        return py::make_tuple(bone, tick, source);
      },
      "path"_a,
      "(bone, ticks executed on it, source) of a flat file. ValueError if it is none, damaged or newer.");
  m.def(
      "write_flat_bone",
      [](const std::string& path, const VoxelBone& bone, std::uint64_t tick, const std::string& source) {
        try {
          without_gil([&] { write_bone(path, bone, tick, source); });
        } catch (const std::system_error& error) {
          errno = error.code().value();
          PyErr_SetFromErrnoWithFilename(PyExc_OSError, path.c_str());
          throw py::error_already_set();
        }
      },
      "path"_a, "bone"_a, "tick"_a, "source"_a, "Writes a flat file. OSError if the system cannot.");
}

}  // namespace

void bind_session(py::module_& m) {
  bind_executor(m);
  bind_counts(m);
  bind_loop_settings(m);
  bind_haptic_loop(m);
  bind_flat_file(m);
}
