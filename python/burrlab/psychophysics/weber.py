"""Published Weber fractions, with what of each source could be read.

A Weber fraction is used as the standard deviation of one interval's noise over its mean. The sources give
just noticeable differences, each at a criterion of its own; none of their abstracts says which, so a noise
could be half as large or twice as large as the number.
"""

from __future__ import annotations

#: Force. Pang, Tan, Durlach, *Manual discrimination of force using active finger motion*, Perception &
#: Psychophysics 49, 1991. Abstract read: roughly 7 % of the reference, 2.5 to 10 N, one-interval paradigm
#: with feedback, 5 subjects. Our forces, 0.3 to 1.5 N, lie below that range.
FORCE = 0.07

#: Force, one hand matched by the other. *Force JND for right index finger using contra lateral force matching
#: paradigm*. Abstract read, without its authors: approximately 10 %, 2 to 5 N, 6 subjects.
FORCE_CONTRALATERAL = 0.10

#: Compliance. Tan, Durlach, Beauregard, Srinivasan, *Manual discrimination of compliance using active pinch
#: grasp: the roles of force and work cues*, Perception & Psychophysics 57, 1995. Abstract read: 22 % where
#: work and terminal force were made useless as cues; with work eliminated the terminal force explains what is
#: left.
COMPLIANCE_WITHOUT_WORK = 0.22

#: Young's modulus of rubber under the fingers. Bergmann Tiest, Kappers, *Cues for haptic perception of
#: compliance*, IEEE Transactions on Haptics 2, 2009. Abstract read: 15 %, the deformation of the surface
#: being felt.
COMPLIANCE_WITH_SURFACE = 0.15

#: Same source: thresholds "more than trebled" without that cue. The abstract gives no number, so this is 3 x
#: 15 %, a lower limit. A burr's handle shows no surface, so it is the one closest to probing.
COMPLIANCE_WITHOUT_SURFACE = 0.45
