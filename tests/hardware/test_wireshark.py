"""Wireshark's dissector of USB3 Vision as judge of what driver and virtual camera send each other."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from napari_elsplus.hardware.protocols import Region
from usb_capture import Capture, CapturedBus

pytestmark = pytest.mark.skipif(
    shutil.which("tshark") is None, reason="tshark (Debian's package of that name, from Wireshark) is not installed"
)
REGION = Region(4, 16, 1040, 1312)


@pytest.fixture(scope="module")
def packets(tmp_path_factory):
    """A session, dissected: configure, stream, stop, with an answer that was asked time for."""
    from faulty_camera import FaultyCamera
    from virtual_devices import CameraBench, PlainBench, Plug

    path = tmp_path_factory.mktemp("wireshark") / "session.pcap"
    plain = PlainBench(real_time=False)
    plug = Plug(FaultyCamera(plain, serial="4711"))
    with Capture(path) as capture:
        bus = CapturedBus(plug, capture)
        with CameraBench(plain, plug, bus).open(wait_for_reader=True) as camera:
            plug.camera.faults.pending_acks = 1
            camera.configure(REGION, slit_rows=3, frame_rate_hz=60)
            camera.start()
            buffer = np.empty(camera.frame_shape, np.uint8)
            for _ in range(3):
                camera.read_into(buffer, 2.0)
    command = ["tshark", "-r", str(path), "-T", "json", "--no-duplicate-keys"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return [packet["_source"]["layers"] for packet in json.loads(done.stdout)]


def values(packets: list, name: str) -> list[str]:
    """Return the values of a field by its name, in order."""
    found: list[str] = []

    def search(node: object) -> None:
        if isinstance(node, dict):
            for key, value in node.items():
                if key == name:
                    found.extend(value if isinstance(value, list) else [value])
                search(value)
        elif isinstance(node, list):
            for item in node:
                search(item)

    search(packets)
    return found


def written(packets: list, register: str) -> list[int]:
    """Return what was written to a bootstrap register, in order: what commands hold, not what answers repeat."""
    commands = [packet for packet in packets if "u3v" in packet and values([packet], "u3v.scd_writemem_cmd")]
    return [int(value, 0) for value in values(commands, f"u3v.bootstrap.{register}")]


def test_no_packet_is_malformed(packets) -> None:
    assert len(packets) > 200
    assert not [packet for packet in packets if "_ws.malformed" in json.dumps(packet)]
    assert set(values(packets, "u3v.gencp.status")) == {"0x0000"}


def test_the_device_is_recognised_by_its_descriptors(packets) -> None:
    assert values(packets, "u3v.device_info.bLength") == ["20"]
    assert values(packets, "u3v.device_info.bmSpeedSupport.superSpeed") == ["1"]


def test_every_command_is_answered_by_its_number(packets) -> None:
    sent = [
        p
        for p in packets
        if "u3v" in p and values([p], "u3v.gencp.command_id") and int(p["usb"]["usb.endpoint_address"], 16) < 0x80
    ]
    ids = [int(values([p], "u3v.gencp.req_id")[0], 0) for p in sent]
    assert len(set(ids)) == len(ids) > 50
    answers = [p for p in packets if "u3v" in p and values([p], "u3v.gencp.status")]
    answered = [int(values([p], "u3v.gencp.req_id")[0], 0) for p in answers]
    assert list(dict.fromkeys(answered)) == ids  # one of them twice: it asked for time first
    assert len(answered) == len(ids) + 1
    assert all(values([p], "u3v.gencp.flag.acq_required") == ["1"] for p in sent)
    assert values(packets, "u3v.gencp.command_id").count("0x0805") == 1


def test_registers_have_the_names_and_values_that_were_meant(packets) -> None:
    assert values(packets, "u3v.bootstrap.Serial_Number") == ["4711"]
    assert values(packets, "u3v.bootstrap.Model_Name") == ["virtual FL3-U3-13S2M"]
    (response_ms,) = values(packets, "u3v.bootstrap.Maximum_Device_Response_Time")
    assert int(response_ms, 0) == 200
    assert set(written(packets, "Timestamp_Latch")) == {1}
    rest = REGION.rows * REGION.cols - (1 << 20)
    assert written(packets, "SI_Payload_Transfer_Size") == [1 << 20]
    assert written(packets, "SI_Payload_Transfer_Count") == [1]
    assert written(packets, "SI_Payload_Final_Transfer1_Size") == [-(-rest // 1024) * 1024]
    assert written(packets, "SI_Payload_Final_Transfer2_Size") == [0]
    assert written(packets, "SI_Maximum_Leader_Size") == [1024]
    assert written(packets, "SI_Maximum_Trailer_Size") == [1024]
    assert written(packets, "SI_Control") == [0, 1, 0]  # what was before is ended, enabled, disabled


def test_leaders_and_trailers_hold_the_region(packets) -> None:
    for field, wanted in (
        ("sizex", REGION.cols), ("sizey", REGION.rows), ("offsetx", REGION.col), ("offsety", REGION.row),
        ("paddingx", 0), ("payload_type", 1), ("pixel_format", 0x0108_0001),
    ):  # fmt: skip
        found = {int(value, 0) for value in values(packets, f"u3v.stream.{field}")}
        assert found == {wanted}, field
    assert {int(size, 0) for size in values(packets, "u3v.stream.valid_payload_size")} == {REGION.rows * REGION.cols}
    blocks = [int(block, 0) for block in values(packets, "u3v.stream.block_id")]
    assert blocks[:6] == [0, 0, 1, 1, 2, 2]
