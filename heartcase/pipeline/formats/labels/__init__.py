"""Labels and markers from files: DICOM SEG, segments in images, STL parts, lists of points."""
