"""Rules and the sampler of curves without their kernels: what the kernels are held to."""

from __future__ import annotations

from nqr_geom.curves.structured import CurveRefine, GwnHermite, SdHermite


class RefineByTensors(CurveRefine):
    """The reference."""

    by_kernel = CurveRefine.by_tensors


class GwnByTensors(GwnHermite):
    """The reference."""

    by_kernel = GwnHermite.by_tensors


class SdByTensors(SdHermite):
    """The reference."""

    by_kernel = SdHermite.by_tensors
