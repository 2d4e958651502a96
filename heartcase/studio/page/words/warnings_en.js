/** Sentences of warnings that name settings of a recipe's file, by their kind, in this page's words; others are said as the server says them. */

/** @type {Record<string, string>} */
export const warnings = {
  "grown-septum": "Walls were grown where two outlines touch, not seen, because a heart does not join these: {listed}. If the patient has an opening there, say so below, or place a septal defect or a landmark there (Shape)",
  "grown-septum-confirmed": "The wall that was grown between {one} and {other} over {area#} mm² near {place} mm is wall, as the recipe says",
  "contact-normal": "{one} and {other} are open to each other in every heart, so what the recipe says of the place near {place} mm has no effect: take this entry out of the recipe, or have a wall grown between the two",
  "opening-unexpected": "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near {place} mm: paint the wall between them (a stroke of background, or of the muscle), or the third cavity whose blood they were given, if one lies there; or, if the patient has this opening, place a septal defect or a landmark there whose name says defect, VSD or ASD (Shape)",
  "opening-too-large": "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near {place} mm, stated by {by}[, where {asked#} mm² are asked for]: the wall around the defect may be missing as well",
  "opening-stated": "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near {place} mm, as stated by {by}[, where {asked#} mm² are asked for]",
  "compartments-joined": "The blood of {one} and of {other}: apart in the segmentation, but joined {where} where the outlines are smoothed; paint a stroke of background, or of the muscle, between them, or smooth less (Shape, Walls)",
  "parts-joined": "Two parts of the blood of {one}: apart in the segmentation, but joined {where} where the outlines are smoothed; paint a stroke of background, or of the muscle, between them, or smooth less (Shape, Walls)",
  "compartments-split": "The blood of {one}[ and of {other}]: in one piece in the segmentation, but cut in two {where} where the passage is narrow; widen it there with a stroke, or smooth less (Shape, Walls)",
  "cavity-cut-by-septum": "{label}: cut in two by a grown septum {where}, where it is narrow and lies along another cavity; make the septum thinner (Shape), or paint the wall between the two",
  "wall-gap": "{label}: its wall has a gap {where}, so it is open to the outside there; if a vessel is cut off there, place a vessel end (Shape), else look at the segmentation there",
  "vessel-open-to-outside": "{label}: its blood is open to the outside {where}, with neither muscle nor a wall between; if it is cut off there, place a vessel end (Shape), else paint the muscle that is missing there and background beyond it, or, where the scan does not show so thin a wall, give the structure a wall (Shape, Walls): a wall grows only where no muscle is",
  "open-to-outside": "{label}: its blood is open to the outside {where}, with neither muscle nor a wall between; paint the muscle that is missing there and background beyond it, or, where the scan does not show so thin a wall, give the structure a wall (Shape, Walls): a wall grows only where no muscle is",
  "adult-walls": "Walls as thick as an adult's are grown around the heart of a child: by its ventricles its body has a surface of about {area#} m². In brackets what fits it: {listed}. Give the walls their thickness (Shape, Walls)",
  "smoothed-away": "{label}: vanished in the smoothing of the outlines, as it is too thin for it; smooth less (Shape, Walls)",
  "smoothed-smaller": "{label}: the smoothing takes {percent#}% of its volume, as it is small; smooth less (Shape, Walls)",
  "smoothed-narrower": "{label}: the smoothing of the outlines narrows it near {place} mm from {before#} mm to {after#} mm; smooth less (Shape, Walls)",
  "smoothed-shut": "{label}: the smoothing of the outlines narrows it near {place} mm from {before#} mm until it is closed; smooth less (Shape, Walls)",
  "closed-sac": "The {label} ends in a closed sac, as no vessel does: place a vessel end where it is cut off (Shape, Find vessel ends)",
  "end-moved": "The disc did not cut the vessel through, so it was moved by {mm#} mm onto it, turned by {degrees#} degrees[ and its radius set to {radius#} mm]: look whether that is the vessel you mean",
  "hanging-tissue": "{count#} <part|parts> of the tissue <hangs|hang> on the rest by an edge or a corner only and can swing freely, at {places}: make the cells smaller, or hold the tissue there (Shape, Pins)",
  "floating-tissue": "{count#} <piece|pieces> of tissue ({cells}) <is|are> attached to nothing that is held still and can drift away; <it|the largest> is at {place} mm: hold it there (Shape, Pins) or remove it",
  "scan-too-large": "The scan is too large to show its thinnest walls in full detail: make the region of interest smaller",
  "surface-error": "With {triangles#} triangles 1% of the visible surface is {off#} mm or more off its full resolution, not {asked#} mm: allow more triangles (Shape)",
};
