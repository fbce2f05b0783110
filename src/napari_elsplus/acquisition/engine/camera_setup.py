"""Settings of the rig's camera, what follows from them, and what a calibration keeps of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.scan.timing import ScanTiming
from napari_elsplus.instrument.calibration import AcquiredWith, FrameSection
from napari_elsplus.instrument.optics import preset

if TYPE_CHECKING:
    from napari_elsplus.hardware.protocols import Camera
    from napari_elsplus.hardware.rig import Rig
    from napari_elsplus.hardware.scan.timing import StrobePhase
    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.instrument.optics import Preset

SETTLING_FRAMES: Final = 2
"""Invalid frames after a change of region or exposure; documented for another camera of the same maker."""


class CameraSetup:
    """The camera of a rig and its settings.

    Parameters
    ----------
    rig : Rig
        Open.

    Attributes
    ----------
    settings : Settings
        Of the camera; the defaults until it is configured.
    settling : int
        Frames of the next stream that are invalid.
    """

    def __init__(self, rig: Rig) -> None:
        self.camera: Camera = rig.camera
        self._rig_name = rig.name
        self.settings = Settings()
        self.settling = 0
        self.configured = False
        """True if the camera has the settings."""

    def configure(self, settings: Settings) -> None:
        """Configure a camera that does not stream by settings; if that fails it is unconfigured.

        Raises
        ------
        InputError
            If the camera cannot do that.
        DeviceError
            If the camera does not answer.
        """
        chosen = preset(settings.preset)
        rate_hz = settings.frame_rate_hz or chosen.optics.frame_rate_hz
        self.configured = False
        region = Region(*chosen.sensor_origin, *chosen.frame_shape)
        self.camera.configure(region, slit_rows=settings.slit_rows, frame_rate_hz=rate_hz, gain_db=settings.gain_db)
        self.settings, self.configured = settings, True
        self.settling = SETTLING_FRAMES

    def require(self) -> None:
        """Refuse to go on with an unconfigured camera.

        Raises
        ------
        InputError
            If the camera is not configured.
        """
        if not self.configured:
            raise InputError("the camera is unconfigured: it has no settings, or they failed", "configure it first")

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self.camera.frame_shape

    @property
    def frame(self) -> FrameSection:
        """The region of the sensor, as a calibration keeps it."""
        return FrameSection(shape=self._preset.frame_shape, sensor_origin=self._preset.sensor_origin)

    @property
    def line_period_s(self) -> float:
        """Seconds from the readout of one row to that of the next."""
        return self.camera.line_period_s

    @property
    def line_periods_per_frame(self) -> float:
        """Line periods from one frame to the next, idle time included."""
        return self.camera.line_periods_per_frame

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second of the camera."""
        return 1 / (self.line_periods_per_frame * self.line_period_s)

    @property
    def bytes_per_s(self) -> float:
        """Data rate of raw frames."""
        rows, cols = self.frame_shape
        return rows * cols * self.frame_rate_hz

    @property
    def acquired_with(self) -> AcquiredWith:
        """The settings, as a calibration keeps them."""
        settings, chosen = self.settings, self._preset
        return AcquiredWith(
            rig=self._rig_name,
            objective=chosen.objective,
            slit_rows=settings.slit_rows,
            frame_rate_hz=settings.frame_rate_hz or chosen.optics.frame_rate_hz,
            gain_db=settings.gain_db,
        )

    def timing(self, strobe: StrobePhase) -> ScanTiming:
        """Return the times at which rows are exposed, with respect to the strobe."""
        return ScanTiming(self.line_period_s, self.line_periods_per_frame, self.settings.slit_rows, strobe)

    def described(self) -> dict[str, Any]:
        """Return the settings as a recording keeps them."""
        return {
            **self.acquired_with.model_dump(),
            "preset": self.settings.preset,
            "line_period_s": self.line_period_s,
            "rows_per_frame": self.line_periods_per_frame,
        }

    def stale(self, calibration: Calibration | None) -> dict[str, str]:
        """Return the sections of a calibration that are stale with these settings, with the reason."""
        if calibration is None or not self.configured:
            return {}
        return calibration.stale_sections(self.acquired_with, self.frame)

    @property
    def _preset(self) -> Preset:
        return preset(self.settings.preset)
