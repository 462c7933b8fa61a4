"""Phase while one records: frames are worked on as they come, and the result is that of a run."""

from napari_phase4d.pipeline.live.feed import LiveStatus
from napari_phase4d.pipeline.live.watching import shown_method, watch

__all__ = ["LiveStatus", "shown_method", "watch"]
