#include <algorithm>
#include <optional>

#include "burrlab/check.hpp"
#include "burrlab/session/haptic_loop.hpp"
#include "records.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

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

void bind_counts(py::module_& m) {
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
}

}  // namespace

void bind_haptic_loop(py::module_& m) {
  bind_counts(m);
  py::class_<LoopReader>(m, "RecordReader", "One reader's place in a loop's ring of records.")
      .def(py::init([](const std::shared_ptr<HapticLoop>& loop) {
             if (!loop) throw std::invalid_argument("loop must be a HapticLoop, got None");
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
    Its bone is refused to others from `start` to the loop's end.
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
    If there is not one device a burr, the rate is above 10 kHz or, on the wall clock, below 2 a `stall_limit`, or a
    limit or the coupling is not positive.
)")
      .def(py::init([](std::shared_ptr<TickExecutor> executor, std::vector<std::shared_ptr<Device>> devices,
                       bool wall_clock, bool realtime, int cpu, double stall_limit, double ring,
                       std::uint64_t ticks, double force_limit, double slew_limit,
                       std::optional<double> coupling) {
             if (!executor) throw std::invalid_argument("executor must be a TickExecutor, got None");
             if (cpu < -1) refuse("cpu", "-1 or the number of a CPU", cpu);
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
           "Starts the thread; once. ValueError the second time, or if the bone or a device is in use.")
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
