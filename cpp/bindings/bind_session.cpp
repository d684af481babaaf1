#include "burrlab/session/mailbox_device.hpp"
#include "burrlab/session/tick_executor.hpp"
#include "records.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

using Tools = std::vector<std::pair<Burr, Material>>;

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
  const VoxelBone::Changing changing(*executor.bone());
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

}  // namespace

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
      .def("set_watch", &TickExecutor::set_watch, py::arg("watch"),
           "Called after each burr's step from now on; it begins with the bone as it is. ValueError unless "
           "it is "
           "of this bone and these burrs.")
      .def(
          "probe",
          [](const TickExecutor& executor, std::size_t burr, const Vec3& center) {
            const VoxelBone::Reading reading(*executor.bone());
            return executor.probe(burr, center);
          },
          py::arg("burr"), py::arg("center"), "The contact of a burr at a centre [mm] now, without erosion.")
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
}
