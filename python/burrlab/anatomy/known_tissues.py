"""Structures of a temporal bone that the default table knows: their names elsewhere, colours and flags."""

from __future__ import annotations

import re
from dataclasses import dataclass

Colour = tuple[int, int, int]

#: Name of the tissue of voxels to which a segmentation gives no structure.
UNLABELLED = "unlabelled"


@dataclass(frozen=True)
class KnownTissue:
    """A structure, its names in segmentations, and what the default table says of it.

    Attributes
    ----------
    name : str
    synonyms : tuple of str
        As `plain_name` writes them.
    colour : (red, green, blue)
    critical, bleeds : bool
        See `Tissue`.
    bone : bool
        Bone, for which there is a published pair of c_e and alpha; which of its kinds the density tells.
    """

    name: str
    synonyms: tuple[str, ...]
    colour: Colour
    critical: bool = True
    bleeds: bool = False
    bone: bool = False


# Colours of structures with a name of volumetric_drilling are those of its PNG stacks; the others are ours, as
# is what counts as critical and what bleeds.
KNOWN = (
    KnownTissue("air", ("void", "empty", "lumen"), (0, 0, 0), critical=False),
    KnownTissue(UNLABELLED, ("background", "clear label", "other"), (128, 128, 128), critical=False),
    KnownTissue("bone", ("temporal bone", "skull"), (255, 249, 219), critical=False, bone=True),
    KnownTissue("cortex", ("cortical bone", "compact bone"), (240, 230, 200), critical=False, bone=True),
    KnownTissue(
        "mastoid",
        ("mastoid bone", "trabecular bone", "cancellous bone", "spongy bone"),
        (235, 205, 165),
        critical=False,
        bone=True,
    ),
    KnownTissue("soft tissue", ("skin", "muscle", "mucosa"), (225, 150, 130), critical=False, bleeds=True),
    KnownTissue("malleus", (), (233, 0, 255)),
    KnownTissue("incus", (), (0, 255, 149)),
    KnownTissue("stapes", (), (63, 0, 255)),
    KnownTissue("ossicles", ("ossicular chain", "auditory ossicles"), (200, 120, 255)),
    KnownTissue(
        "labyrinth", ("bony labyrinth", "vestibule cochlea", "inner ear", "otic capsule"), (91, 123, 91)
    ),
    KnownTissue("cochlea", (), (120, 160, 90)),
    KnownTissue("semicircular canals", ("semicircular canal", "scc"), (60, 110, 60)),
    KnownTissue(
        "internal auditory canal",
        ("iac", "internal acoustic meatus", "internal acoustic canal", "internal auditory meatus"),
        (244, 142, 52),
        critical=False,
    ),
    KnownTissue("vestibulocochlear nerve", ("cn viii",), (230, 120, 40)),
    KnownTissue("vestibular nerve", (), (200, 130, 70)),
    KnownTissue("superior vestibular nerve", (), (255, 191, 135)),
    KnownTissue("inferior vestibular nerve", (), (121, 70, 24)),
    KnownTissue("cochlear nerve", (), (219, 244, 52)),
    KnownTissue("facial nerve", ("facial", "cn vii", "fallopian canal", "facial canal"), (244, 214, 49)),
    KnownTissue("chorda tympani", ("chorda",), (151, 131, 29)),
    KnownTissue(
        "internal carotid artery", ("ica", "carotid", "carotid artery"), (216, 100, 79), bleeds=True
    ),
    KnownTissue("sinus and dura", (), (110, 184, 209), bleeds=True),
    KnownTissue("sigmoid sinus", ("sinus", "transverse sinus"), (70, 90, 200), bleeds=True),
    KnownTissue("jugular bulb", ("jugular", "jugular vein", "internal jugular vein"), (50, 60, 160), bleeds=True),
    KnownTissue("dura", ("dura mater",), (120, 200, 220), bleeds=True),
    KnownTissue("brain", ("temporal lobe", "cerebellum"), (245, 190, 190), bleeds=True),
    KnownTissue("vestibular aqueduct", (), (91, 98, 123)),
    KnownTissue(
        "temporomandibular joint", ("tmj", "mandible", "mandibular condyle", "condyle"), (100, 0, 0),
        critical=False,
    ),
    KnownTissue(
        "external auditory canal",
        ("eac", "ear canal", "external acoustic meatus", "external auditory meatus", "external ear canal"),
        (255, 225, 214),
        critical=False,
    ),
    KnownTissue("tympanic membrane", ("eardrum",), (250, 170, 160)),
)  # fmt: skip

_UNSAID = frozenset({"and", "the", "of", "left", "right", "l", "r", "lt", "rt"})


def plain_name(name: str) -> str:
    """A structure's name in lower case, without signs, sides and small words: Sinus_+_Dura is sinus dura."""
    words = re.findall(r"[a-z0-9]+", name.lower())
    return " ".join(word for word in words if word not in _UNSAID)


_BY_NAME = {plain_name(text): known for known in KNOWN for text in (known.name, *known.synonyms)}


def known_tissue(name: str) -> KnownTissue | None:
    """What the default table says of a structure; None where it does not know the name."""
    return _BY_NAME.get(plain_name(name))


#: Of the known tissues, those that are empty where labels alone make a bone.
EMPTY = ("air", "external auditory canal")

#: The colours of volumetric_drilling's PNG stacks (LCSR-SICKKIDS/volumetric_drilling, its script that makes distance
#: grids lists them), by its names and in its order, which is that of our labels 1 to 16.
VOLUMETRIC_DRILLING: dict[str, Colour] = {
    name: known.colour
    for name in (
        "Bone", "Malleus", "Incus", "Stapes", "Bony_Labyrinth", "IAC", "Superior_Vestibular_Nerve",
        "Inferior_Vestibular_Nerve", "Cochlear_Nerve", "Facial_Nerve", "Chorda_Tympani", "ICA", "Sinus_+_Dura",
        "Vestibular_Aqueduct", "TMJ", "EAC",
    )
    if (known := known_tissue(name)) is not None
}  # fmt: skip
