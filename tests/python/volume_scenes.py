"""Small volumes and their files, for tests."""

import numpy as np

from burrlab import Volume, write_volume

ASKEW = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
TURNED = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])


def a_volume(kind="i2", direction=TURNED):
    values = (np.arange(3 * 4 * 5).reshape(3, 4, 5) * 3 - (50 if kind[0] != "u" else 0)).astype(kind)
    return Volume(values, (0.1, 0.25, 0.7), (-31.25, 12.5, 1024.0), direction, "made")


def slab(path, spacing=0.4):
    """20 x 20 x 12 mm, rotated, with an empty upper third."""
    n = [round(side / spacing) for side in (20, 20, 12)]
    values = np.full(n[::-1], 1000, np.int16)
    values[2 * n[2] // 3 :] = -1000
    volume = Volume(values, (spacing,) * 3, (100, 50, -20), ASKEW, "slab")
    write_volume(path, volume)
    entry = volume.origin + ASKEW @ (10, 10, 11.5)
    return volume, [
        f"--entry={','.join(map(repr, entry.tolist()))}",
        f"--axis={','.join(map(repr, (-ASKEW[:, 2]).tolist()))}",
    ]


def nifti(path, values, *, affine=None, units="mm", **header):
    """NIfTI-1 by nibabel; without an affine its codes are 0."""
    import nibabel

    image = nibabel.Nifti1Image(values.T, affine)
    image.header.set_xyzt_units(units)
    for key, value in header.items():
        image.header[key] = value
    nibabel.save(image, path)


def raw(path, head, values=None):
    values = a_volume().values if values is None else values
    end = "\n" if path.suffix == ".nrrd" else "ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    path.write_bytes((head + end).encode() + values.tobytes())
    return path
