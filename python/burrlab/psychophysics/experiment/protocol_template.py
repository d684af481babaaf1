"""A protocol to begin with."""

from __future__ import annotations

_TEMPLATE = """\
# An experiment of burrlab: `burrlab experiment run FILE --subject 01`. docs/experiment.md explains every key.
# Examples that are switched off begin with # and no space after it.

[experiment]
name = "Bone and PVC, probed and drilled"
seed = 1                    # of all orders and intervals
subjects = 12               # a number (01, 02, ...) or a list of names of letters and digits
folder = "data"             # for the answers, beside this file
device = "hand"             # hand (simulated), igtl:HOST:PORT, or scripted:FILE
#lost_after_ms = 100.0      # a position over the network that old is a lost device
#publish = 18945            # port at which igtl's peer takes the force; without it there is none
trace = false               # true keeps a complete trace of every interval
feedback = false            # true tells the subject in practice whether the answer was right
pause_s = 1.0               # after an interval
break_s = 60.0              # at least, between blocks
#selected_by = "score in an earlier experiment"   # if the subjects were: the report warns of it
#selected_from = 20         # of how many

[burr]
radius_mm = 3.0

[bone]                      # a block with its top at z = 0, fresh for each interval
size_mm = [30.0, 30.0, 20.0]
voxel_mm = 0.1

# Known are bone, pettigrew, pvc and expert, the paper's. Others, by name:
#[materials.soft]
#c_e = 1.9                  # [N/mm^2]
#alpha = 0.087              # [1/ms], for the shape
#shape = "parabolic"

# A real specimen, outside the program:
#[materials.specimen]
#real = true

# Each subject has all tasks, in counterbalanced order. This is the paper's Task 1.
[tasks.probing]
design = "same-different"   # AA, AB, BA, BB equally often
a = "bone"
b = "pvc"
mode = "probing"            # the burr does not turn
trials = 12                 # a multiple of 4
interval_s = 20.0
practice = 0                # trials before, which do not count
blocks = 1                  # with breaks between them

[tasks.drilling]
design = "same-different"
a = "bone"
b = "pvc"
mode = "drilling"
trials = 12
interval_s = 20.0

# The paper's Task 3: the real specimen as long as the subject likes, then two simulated ones. Which felt like it?
#[tasks.match]
#design = "abx"
#reference = "specimen"
#match = "pettigrew"        # the correct answer; without it the reference itself
#foil = "pvc"
#trials = 10
#interval_s = 10.0          # reference_interval_s = 10.0 would end the reference too

# How much stiffer must it be? Ratios of c_e to the reference's, each equally often.
#[tasks.levels]
#design = "constant-stimuli"
#reference = "bone"
#parameter = "c_e"
#levels = [1.05, 1.1, 1.2, 1.4, 1.8]
#repeats = 20
#interval_s = 5.0

# The same by a staircase, two correct answers down and one wrong up: 70.7 % correct.
#[tasks.staircase]
#design = "staircase"
#reference = "bone"
#parameter = "c_e"
#start = 2.0
#down = 2
#interval_s = 5.0

# The width of alpha by a Bayesian staircase; with the burr off alpha alone changes nothing.
#[tasks.adaptive]
#design = "adaptive"
#reference = "bone"
#parameter = "alpha"
#mode = "drilling"
#trials = 60
#interval_s = 5.0

[analysis]                  # settled before the first subject; it goes into every file
rules = ["independent-observations", "differencing"]
level = 0.95
#delta = 1.5                # d' below which the two count as alike: an equivalence test
"""


def template() -> str:
    """TOML of the paper's Task 1, with examples of every other design switched off.

    Examples
    --------
    >>> print(template().splitlines()[3])
    [experiment]
    """
    return _TEMPLATE
