"""Base class of panels that use the engine: shared connection, requests that do not block, cleanup with the window."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from napari.utils.notifications import show_info

from napari_elsplus._problems import notify_errors
from napari_elsplus._view import read_units
from napari_elsplus.errors import InputError
from napari_elsplus.hardware.rig_files import is_simulated
from napari_elsplus.io.calibration_lookup import active_calibration_for_rig
from napari_elsplus.widgets.shared.calibration_state import measured_lag
from napari_elsplus.widgets.shared.connection import join
from napari_elsplus.widgets.shared.panel import Panel, timer
from napari_elsplus.widgets.shared.requests import PendingRequests
from napari_elsplus.widgets.shared.rig_choice import remembered_rig, remembered_settings

if TYPE_CHECKING:
    from collections.abc import Callable

    import napari.viewer

    from napari_elsplus.acquisition.link.client import EngineClient
    from napari_elsplus.instrument.calibration import Calibration


class EnginePanel(Panel):
    """A docked panel that uses the engine, and releases it at its end.

    Parameters
    ----------
    viewer : napari.Viewer
        The viewer it is docked to.

    Attributes
    ----------
    connection : Connection
        The engine and the active calibration, shared by all panels.
    requests : PendingRequests
        Delivers the engine's answers, then calls :meth:`refresh`.
    """

    def __init__(self, viewer: napari.viewer.Viewer) -> None:
        super().__init__(viewer)
        self.connection = join()
        self.requests = PendingRequests(self, self.refresh)
        timer(self, 0, read_units, once=True, starts=True)  # before a layer, or a thread that makes one, needs them
        self._closed = False
        self._leave = _once(self.connection.leave)
        self.destroyed.connect(self._leave)  # also where its window is closed before the panel was found docked in it
        self._parks = 0

    @property
    def waiting(self) -> bool:
        """True while a request of this panel is outstanding, or a panel is connecting to a rig."""
        return self.requests.busy or self.connection.connecting is not None

    def refresh(self) -> None:
        """Update what the panel shows; called after each answer of the engine, and by the panel's own timer."""

    def prepare_rig(self, then: Callable[[EngineClient], None]) -> None:
        """Connect to the rig used last unless one is connected, and give it a calibration; then go on.

        Parameters
        ----------
        then : callable
            Called with the client. It starts the stream by :meth:`start_stream`.

        Notes
        -----
        A rig that has no calibration gets the active one (:meth:`activate_calibration`); the simulated rig is
        calibrated where that is missing, too.
        """
        self._parks = self.connection.parks
        client = self.connection.client
        if client is not None:
            self._calibrate_and(then, client)
            return
        rig, settings = remembered_rig(), remembered_settings()
        self.requests.run(lambda: self.connection.connect(rig, settings), partial(self._calibrate_and, then))

    def activate_calibration(self, client: EngineClient, then: Callable[[], None] = lambda: None) -> None:
        """Apply the active calibration to a rig that has none, then go on, whether the rig accepts it or not.

        Parameters
        ----------
        client : EngineClient
            Client of a rig that has just been connected.
        then : callable
            Called afterwards.

        Notes
        -----
        The calibration shared by the panels comes first, then the active file unless it was acquired with another rig.
        """
        active, path = self.connection.calibration, self.connection.calibration_file
        if active is None:
            with notify_errors(self):
                active, path = active_calibration_for_rig(self.connection.rig)
        if active is None or client.calibration is not None:
            then()
        else:
            self.requests.follow(self.connection.apply(active, path), lambda _: then(), failed=then)

    def _calibrate_and(self, then: Callable[[EngineClient], None], client: EngineClient) -> None:
        def go_on() -> None:
            if client.calibration is None and is_simulated(self.connection.rig):
                self.requests.follow(client.use_simulated_calibration(), lambda _: then(client))
            else:
                then(client)

        self.activate_calibration(client, go_on)

    def start_stream(self, client: EngineClient) -> None:
        """Start the stream of a client, unless the galvo was parked since :meth:`prepare_rig`."""
        if self._parks == self.connection.parks:
            self.requests.follow(client.start())
        else:
            show_info("the galvo was parked meanwhile, so the stream was not started: start it again")

    def measure_lag(self) -> None:
        """Measure the scan lag of the active calibration on the connected rig, and activate the result."""
        with notify_errors(self):
            client, active = self.connection.require(), self.connection.calibration
            if active is None:
                raise InputError("there is no calibration to complete", "calibrate, or load a calibration")
            self.requests.run(measured_lag(client, active), self._activate_measured)

    def _activate_measured(self, calibration: Calibration) -> None:
        self.requests.follow(
            self.connection.apply(calibration),
            lambda _: show_info("scan lag measured and active; save the calibration to keep it"),
        )

    def cleanup(self) -> None:
        """Release the engine and disconnect from the viewer."""
        if self._closed:
            return
        self._closed = True
        self.requests.stop()
        self._leave()
        super().cleanup()
        if self.parent() is None:  # released by the dock, and owned by nothing else
            self.deleteLater()


def _once(call: Callable[[], None]) -> Callable[..., None]:
    """Return a function that makes a call the first time, whatever it is given, and nothing later."""
    calls = [call]

    def first(*_: object) -> None:
        if calls:
            calls.pop()()

    return first
