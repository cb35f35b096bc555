"""Print the Debian packages of the shared libraries that bpy needs and this machine lacks, on one line."""

import ctypes
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


def is_missing(library: str) -> bool:
    """Whether the dynamic linker cannot find a library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return True
    return False


if __name__ == "__main__" and sys.platform == "linux":
    sys.stdout.write(" ".join(package for library, package in PACKAGES.items() if is_missing(library)))
