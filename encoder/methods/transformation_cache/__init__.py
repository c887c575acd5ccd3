"""The gated Neural Transformation Cache (NTC): a hash grid and a small MLP that move the selected Gaussians.

A normalised centre x in the box goes through a multi-resolution hash grid and an MLP to a translation (world units) and
a rotation (quaternion wxyz): mu' = mu + dmu, q' = normalise(q) (x) normalise(dq). Only the M Gaussians that were placed
are moved; a Gaussian outside the box keeps its centre and gets no gradient.
Sources: DecoGS (gating, use), 3DGStream (configuration), Instant-NGP, Mueller 2022 (hash grid).

The arithmetic is a C++ kernel (``native``). What makes it fast, none of it an approximation:

- Within a frame the grid is read at fixed points (the centres as placed), so which entries are read, and with what
  trilinear weights, is found once.
- Adam leaves an entry with zero gradient and zero moments where it is. Moments start at zero with each frame, so the
  entries that no placed centre reads never change: only those read are trained, and written back to the table at the
  end ("settling").
- A level at a time: its gradient is gathered, spent in Adam and its features are read again for the next pass while
  its rows are in the processor's cache. The MLP's products run in registers over blocks of 64 Gaussians.

All of it is float32: the cosine of the quaternion loss is known to overflow in fp16. Products and sums are rounded
apart, since not every instruction set can fuse them: the same bits on each of them and for any number of threads.

Measured, processor-ms per iteration (moved, backward, step) at the defaults, one core of a Zen 3 with AVX2, in turn
with the torch version that this replaced (embedding_bag, MKL): 15 against 4.3 for 3,000 Gaussians, 52 against 19 for
14,000, 167 against 62 for 50,000. At 14,000 the MLP's products take 57 per cent of it, at 70 GFLOP/s where multiply and
add apart reach 100; reading the grid and its way back take 26, Adam 6.

Rejected: torch, whose matrix products have other bits on other processors; sorting the Gaussians in space (the grid
then is 1 to 6 per cent faster); prefetching its rows (slower).
"""

from .cache import TransformationCache
from .weights import RELEASED_CACHE, CacheConfig, CacheWeights

__all__ = ["RELEASED_CACHE", "CacheConfig", "CacheWeights", "TransformationCache"]
