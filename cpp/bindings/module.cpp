#include "bindings.hpp"
#include "cpu_path.hpp"
#include "tick.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "The C++ core of burrlab; private: import from burrlab.";
  m.attr("__version__") = BURRLAB_VERSION;
  cpu_path();  // throws if BURRLAB_CPU_PATH is wrong
  m.def("cpu_paths", &cpu_paths, "The tick's code paths that this CPU runs, plainest first.");
  m.def("cpu_path", &cpu_path,
        "The path of new contacts: the fastest, or that of the environment variable BURRLAB_CPU_PATH.");
  m.def("use_cpu_path", &use_cpu_path, "name"_a,
        "Sets the path of new contacts; all give equal bits. ValueError unless one of `cpu_paths()`.");
  m.def(
      "draws",
      [](const Index3& shape, std::uint64_t seed, std::uint64_t tick, std::uint32_t index,
         std::uint32_t draw) {
        for (const std::int64_t n : shape)
          if (n < 0) refuse("every side of shape", "at least 0", double(n));
        if (draw > 1) refuse("draw", "0 or 1", draw);
        const auto field = random_field(shape, seed, tick, index, draw);
        return py::array_t<std::uint16_t>({shape[0], shape[1], shape[2]}, field.data());
      },
      "shape"_a, "seed"_a, "tick"_a, "index"_a = 0, "draw"_a = 0,
      "The 16-bit random numbers of a tick by voxel, (nz, ny, nx) uint16; draw 0 is U, 1 is V "
      "(docs/tick.md).");
  bind_material(m);
  bind_tissues(m);
  bind_voxel_bone(m);
  bind_force(m);
  bind_burr_contact(m);
  bind_force_controller(m);
  bind_mean_field(m);
  bind_anatomy(m);
  bind_session(m);
  bind_follower(m);
  bind_device(m);  // after the base class
  bind_network_devices(m);
  bind_network(m);
  bind_effect_parameters(m);
  bind_effects(m);
  bind_surface(m);
  for (const char* name : {"Burr", "Material", "VoxelBone"})
    m.attr(name).attr("_repr_html_") = py::cpp_function(
        [](const py::object& shown) {
          return py::module_::import("burrlab.bone.image").attr("object_html")(shown);
        },
        py::name("_repr_html_"), py::is_method(m.attr(name)), "A table for notebooks.");
}
