"""Marker-based watershed that answers while the brush moves (thesis 11.1.1).

What it computes, exactly
    Voxels are joined through their six faces. A voxel is *higher* than another when its height is greater, or equal
    and its index (x fastest) greater. Faces are in strict order: by their higher voxel, and those of one higher voxel
    by their lower one. Every voxel gets the label of the marked voxel that it hangs on in the minimum spanning forest
    under this order which is rooted in all marked voxels: so its label reaches it over the lowest pass there is, and
    there is one such forest only. (Cousty, Bertrand, Najman and Couprie, "Watershed cuts: minimum spanning forests and
    the drop of water principle", IEEE Trans. Pattern Analysis and Machine Intelligence 31, 2009: the watershed cuts are
    the cuts of such forests.)

    One rule comes before it. A flat minimum (voxels of one height that hang together and have no lower neighbour)
    which is marked with two labels or more is divided first: each of its voxels takes the label of the marked voxel
    from which the way inside the flat costs least; of equal ones, of the neighbour with the lowest index through which
    a cheapest way leads. What a step costs comes with the landscape. So two floods meet half way, or where the steps
    are dear, and a fixed order of the faces would give nearly all to one of them.

Why it is fast
    Under this order every voxel's own lowest face leads to its lowest neighbour, so without markers the minimum
    spanning tree consists of these steps, which gather the voxels in basins, and of one face less than there are
    basins. It does not depend on the markers. They only cut it: a marked voxel cuts what is above it in its basin from
    the rest, and at most one face on each way between two labels is left out.
"""
