"""Run the checks of the USB3 Vision driver on Linux's own USB stack: ``python3 run.py test --rig``.

QEMU boots the kernel of this computer's distribution, with this computer's files to read; the virtual camera is on its
bus by USB/IP. What the kernel, libusb and aravis make of it is judged, not the speed: the processor is emulated.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from ctypes.util import find_library
from pathlib import Path

from rig.usbip import CameraServer

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "virtio_net", "vhci-hcd")
PACKAGES = {
    "qemu-system-x86": "qemu-system-x86_64",
    "busybox-static": "busybox",
    "kmod": "modprobe",
    "aravis-tools-cli": "arv-tool-0.8",
}
"""Debian's packages, and the program that is in each."""


def missing_packages() -> list[str]:
    """Return the packages that are not installed."""
    missing = [package for package, program in PACKAGES.items() if not shutil.which(program)]
    missing += [] if find_library("usb-1.0") else ["libusb-1.0-0"]
    return missing if kernels() else [*missing, "linux-image-amd64"]


def kernels() -> list[Path]:
    """Return the installed kernels that can have a bus by USB/IP, the newest last."""
    found = sorted(Path("/boot").glob("vmlinuz-*"), key=lambda file: file.stat().st_mtime)
    return [file for file in found if any(modules_of(file).glob("kernel/drivers/usb/usbip/vhci-hcd.ko*"))]


def modules_of(kernel: Path) -> Path:
    """Return the folder of a kernel's modules."""
    return Path("/lib/modules", kernel.name.removeprefix("vmlinuz-"))


def initial_files(folder: Path, kernel: Path, settings: str) -> Path:
    """Return an archive of what the kernel starts with: busybox, the modules, the script, and its settings."""
    root = folder / "root"
    (root / "bin").mkdir(parents=True)
    shutil.copy(shutil.which("busybox") or "", root / "bin")
    shutil.copy(Path(__file__).with_name("init"), root / "init")
    (root / "init").chmod(0o755)
    (root / "settings").write_text(settings)
    order: list[str] = []
    for module in MODULES:
        command = ["modprobe", "-S", modules_of(kernel).name, "--show-depends", module]
        lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        order += [line.split()[1] for line in lines if line.startswith("insmod")]
    for file in dict.fromkeys(order):
        (root / file[1:]).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, root / file[1:])
    (root / "modules").write_text("".join(f"{file}\n" for file in dict.fromkeys(order)))
    names = "\n".join(str(path.relative_to(root)) for path in sorted(root.rglob("*")))
    with (folder / "initrd").open("wb") as archive:
        cpio = ["busybox", "cpio", "-o", "-H", "newc"]
        subprocess.run(cpio, cwd=root, input=names.encode(), stdout=archive, stderr=subprocess.DEVNULL, check=True)
    return folder / "initrd"


def boot(kernel: Path, initrd: Path) -> subprocess.Popen[str]:
    """Start the machine; its console is the process's output."""
    share = "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"
    command = [
        "qemu-system-x86_64", "-accel", "tcg", "-cpu", "max", "-m", "1024", "-no-reboot",
        "-display", "none", "-serial", "stdio", "-virtfs", share,
        "-netdev", "user,id=net", "-device", "virtio-net-pci,netdev=net,romfile=",
        "-kernel", str(kernel), "-initrd", str(initrd), "-append", "console=ttyS0 quiet panic=-1",
    ]  # fmt: skip
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)


def main() -> int:
    """Run the checks; return 0 if all passed, 1 if one failed or the machine did not, 2 if packages are missing."""
    missing = missing_packages()
    if missing:
        install = f"sudo apt-get install --no-install-recommends {' '.join(missing)}"
        print(f"run.py: the rig needs system packages: run `{install}`, then start again", file=sys.stderr)
        return 2
    variables = {
        "PATH": f"{os.defpath}:/usr/sbin", "PYTHONPATH": f"{ROOT / 'src'}:{ROOT / 'tests'}",
        "PYTHONDONTWRITEBYTECODE": "1", "HOME": "/run", "TMPDIR": "/run",
    }  # fmt: skip
    environment = " ".join(f"{name}={value}" for name, value in variables.items())
    server, kernel, passed = CameraServer(), kernels()[-1], False
    command = shlex.join([sys.executable, "-m", "rig.guest", str(server.port), *sys.argv[1:]])
    settings = f"run() {{ /bin/busybox chroot /root /usr/bin/env -i {environment} {command}; }}\n"
    with tempfile.TemporaryDirectory() as folder:
        machine = boot(kernel, initial_files(Path(folder), kernel, settings))
        try:
            assert machine.stdout is not None
            for line in machine.stdout:
                verdict = re.match(r"(\d+) of (\d+) checks passed", line)
                passed |= verdict is not None and verdict[1] == verdict[2]
                print(line.rstrip(), flush=True)
        finally:
            machine.kill()
            machine.wait()
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
