"""Virtual bone-burring experiments: forces, erosion, descents and fits of c_e and alpha."""

import burrlab.starting  # noqa: F401  # isort: skip  # before all others
from burrlab._core import (
    Burr,
    BurrContact,
    Contact,
    ContactSeries,
    Device,
    ForceController,
    HandDevice,
    IgtlDevice,
    MailboxDevice,
    Material,
    ReplayDevice,
    ScriptedDevice,
    Shape,
    Tissue,
    Tissues,
    VoxelBone,
    __version__,
    elastic_force,
    erode,
    moments,
    penetration,
)
from burrlab.bone_field import BoneField
from burrlab.bone_scatter import predicted_scatter
from burrlab.curve import VelocityCurve
from burrlab.depth_trace import DepthTrace
from burrlab.descent import descend
from burrlab.descent_result import Descent
from burrlab.fitting.coverage import coverage_study
from burrlab.fitting.design import design
from burrlab.fitting.design_result import Design
from burrlab.fitting.experiment import Experiment
from burrlab.fitting.fit import Fit, fit
from burrlab.fitting.shape_comparison import ShapeComparison
from burrlab.fitting.shapes import compare_shapes
from burrlab.indentation import Indentation
from burrlab.master_curve import MasterCurve, penetration_velocity
from burrlab.materials import materials
from burrlab.mean_field import MeanFieldDescent, mean_field_descent, thin_layer_velocity
from burrlab.rig import Rig, RigReading, VirtualRig
from burrlab.session.metrics import SessionMetrics, session_metrics
from burrlab.session.replay import Replay, replay
from burrlab.session.report import SessionReport
from burrlab.session.script import read_script
from burrlab.session.session import Session
from burrlab.session.snapshot import load_bone, save_bone
from burrlab.session.trace import Trace, load_trace
from burrlab.session.trace_writer import TraceWriter
from burrlab.session.volumetric_drilling import export_volumetric_drilling
from burrlab.specimen import Specimen, half_space, surface_along
from burrlab.store import Store
from burrlab.study import StudyInterrupted
from burrlab.sweep import force_sweep
from burrlab.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace
from burrlab.volume import LabelVolume, OccupancyMap, Volume, read_labels, read_volume, write_volume

__all__ = [
    "BoneField",
    "Burr",
    "BurrContact",
    "Contact",
    "ContactSeries",
    "DepthTrace",
    "Descent",
    "Design",
    "Device",
    "Experiment",
    "Fit",
    "ForceController",
    "HandDevice",
    "IgtlDevice",
    "Indentation",
    "LabelVolume",
    "MailboxDevice",
    "MasterCurve",
    "Material",
    "MeanFieldDescent",
    "OccupancyMap",
    "Replay",
    "ReplayDevice",
    "Rig",
    "RigReading",
    "ScriptedDevice",
    "Session",
    "SessionMetrics",
    "SessionReport",
    "Shape",
    "ShapeComparison",
    "Specimen",
    "Store",
    "StudyInterrupted",
    "Tissue",
    "Tissues",
    "Trace",
    "TraceWriter",
    "VelocityCurve",
    "VirtualRig",
    "Volume",
    "VoxelBone",
    "__version__",
    "compare_shapes",
    "coverage_study",
    "descend",
    "design",
    "elastic_force",
    "erode",
    "export_volumetric_drilling",
    "fit",
    "force_sweep",
    "half_space",
    "load_bone",
    "load_trace",
    "materials",
    "mean_field_descent",
    "moments",
    "penetration",
    "penetration_velocity",
    "predicted_scatter",
    "read_labels",
    "read_script",
    "read_volume",
    "replay",
    "save_bone",
    "session_metrics",
    "surface_along",
    "synthetic_curve",
    "synthetic_indentation",
    "synthetic_trace",
    "thin_layer_velocity",
    "write_volume",
]
