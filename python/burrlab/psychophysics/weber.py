"""Published Weber fractions, and which part of each source was read.

A Weber fraction is used here as the standard deviation of one interval's noise over its mean. The sources
give just noticeable differences, each at its own criterion. No abstract states the criterion, so the noise
could be half or twice the number.
"""

#: Force. Pang, Tan, Durlach, *Manual discrimination of force using active finger motion*, Perception &
#: Psychophysics 49, 1991. Abstract read: roughly 7 % of the reference, 2.5 to 10 N, one-interval paradigm
#: with feedback, 5 subjects. The forces here, 0.3 to 1.5 N, lie below that range.
FORCE = 0.07

#: Force of one hand, matched by the other. *Force JND for right index finger using contra lateral force
#: matching paradigm*. Abstract read, authors unknown: approximately 10 %, 2 to 5 N, 6 subjects.
FORCE_CONTRALATERAL = 0.10

#: Compliance. Tan, Durlach, Beauregard, Srinivasan, *Manual discrimination of compliance using active pinch
#: grasp: the roles of force and work cues*, Perception & Psychophysics 57, 1995. Abstract read: 22 % where
#: neither work nor terminal force is a useful cue. Without work cues, terminal force explains the results.
COMPLIANCE_WITHOUT_WORK = 0.22

#: Young's modulus of rubber under the fingers. Bergmann Tiest, Kappers, *Cues for haptic perception of
#: compliance*, IEEE Transactions on Haptics 2, 2009. Abstract read: 15 % where the deformation of the surface
#: is felt.
COMPLIANCE_WITH_SURFACE = 0.15

#: Same source: thresholds "more than trebled" without the surface cue. The abstract gives no number, so this
#: value is 3 x 15 %, a lower limit. It is closest to probing, because a burr's handle shows no surface.
COMPLIANCE_WITHOUT_SURFACE = 0.45
