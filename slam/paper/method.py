"""The method ``paper`` as it is registered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from moteslam.slam.methods import Method
from moteslam.slam.paper.config import PaperFilterConfig

if TYPE_CHECKING:
    from moteslam.slam.paper.filter import PaperFilter


def _make(config: PaperFilterConfig, seed: int) -> PaperFilter:
    from moteslam.slam.paper.filter import PaperFilter

    return PaperFilter(config, seed)


METHOD = Method(PaperFilterConfig, _make)
