"""The method ``tsdf`` as it is registered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from moteslam.slam.methods import Method
from moteslam.slam.tsdf.config import TsdfFilterConfig

if TYPE_CHECKING:
    from moteslam.slam.tsdf.filter import TsdfFilter


def _make(config: TsdfFilterConfig, seed: int) -> TsdfFilter:
    from moteslam.slam.tsdf.filter import TsdfFilter

    return TsdfFilter(config, seed)


METHOD = Method(TsdfFilterConfig, _make, needs_odometry=False)
