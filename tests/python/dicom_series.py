"""Small DICOM series for tests, written with pydicom."""

import numpy as np
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

RIGHT, BACK = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def write_slice(
    path, pixels, position, *, series, number=1, spacing=(0.5, 0.25), rows=RIGHT, columns=BACK, **changes
):
    """Writes a slice; `spacing` is PixelSpacing (rows, columns). A change of None deletes the element."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=[str(path), series])
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    slice_ = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    elements = {
        "SOPClassUID": CTImageStorage, "SOPInstanceUID": meta.MediaStorageSOPInstanceUID,
        "SeriesInstanceUID": series, "StudyInstanceUID": "1.2.3",
        "Modality": "CT", "PatientID": "phantom", "InstanceNumber": number,
        "ImagePositionPatient": [f"{p:.6f}" for p in position],
        "ImageOrientationPatient": [f"{v:.6f}" for v in (*rows, *columns)],
        "PixelSpacing": [f"{s:g}" for s in spacing],
        "SamplesPerPixel": 1, "PhotometricInterpretation": "MONOCHROME2",
        "Rows": pixels.shape[0], "Columns": pixels.shape[1],
        "BitsAllocated": 16, "BitsStored": 16, "HighBit": 15, "PixelRepresentation": 1,
        "RescaleSlope": "1", "RescaleIntercept": "0",
        "PixelData": np.asarray(pixels, dtype="<i2").tobytes(),
    }  # fmt: skip
    slice_.update({name: value for name, value in (elements | changes).items() if value is not None})
    slice_.save_as(path, enforce_file_format=True)


def write_series(
    folder, values, *, series="1.2.3.4", step=0.75, first=(1.0, 2.0, 3.0), names=None, **options
):
    """Writes values (z, y, x) as slices `step` apart; `names` are file names."""
    folder.mkdir(exist_ok=True)
    rows, columns = options.get("rows", RIGHT), options.get("columns", BACK)
    normal = np.cross(rows, columns)
    for k, pixels in enumerate(values):
        name = f"slice{k:03d}.dcm" if names is None else names[k]
        write_slice(
            folder / name, pixels, np.array(first) + k * step * normal, series=series, number=k + 1, **options
        )
