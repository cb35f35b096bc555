"""The shared libraries that Blender needs and this machine lacks, as names of Debian packages.

As a program (`scripts/setup`, before anything is installed) it prints them on one line.
"""

import ctypes
import re
import sys

# What `ldd` names outside the bpy wheel (4.5, Linux x86-64).
PACKAGES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXext.so.6": "libxext6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
}
# The dynamic linker's message for a missing library.
NOT_FOUND = re.compile(r"(\S+\.so[\w.]*): cannot open shared object file")


def missing_packages() -> list[str]:
    """The packages of the libraries that the dynamic linker cannot find."""
    return [package for library, package in PACKAGES.items() if _is_missing(library)]


def install_hint(message: str) -> str:
    """How to install what an error of the dynamic linker misses, with all else that is missing; "" for others."""
    found = NOT_FOUND.search(message)
    if found is None:
        return ""
    if found[1] not in PACKAGES:
        return "; install the package of your system that has it"
    packages = dict.fromkeys([PACKAGES[found[1]], *missing_packages()])
    return f"; install it: sudo apt-get install -y {' '.join(packages)}"


def _is_missing(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return True
    return False


if __name__ == "__main__" and sys.platform == "linux":
    sys.stdout.write(" ".join(missing_packages()))
