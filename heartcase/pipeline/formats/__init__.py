"""Files read and written: DICOM, image volumes, labels and markers of other programs."""
