#include "bindings.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "The C++ core of burrlab; private: import from burrlab.";
  m.attr("__version__") = BURRLAB_VERSION;
  m.attr("cpu_path") = "generic";
  bind_shape(m);
  bind_material(m);
  bind_voxel_bone(m);
  bind_force(m);
  bind_burr_contact(m);
  bind_force_controller(m);
  bind_mean_field(m);
}
