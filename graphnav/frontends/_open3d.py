"""Open3D, imported where it is used: 0.9 GB on disk and about a second to load.

Its wheel is linked to libusb-1.0 for depth cameras, which few machines have and nothing here uses. The package
`libusb-package` carries that library; once it is loaded with global symbols, Open3D finds it. The libraries of OpenGL,
to which it is linked too, no package of pip carries.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from graphnav.errors import GraphnavError


@cache
def open3d() -> Any:
    """The package open3d.

    Raises
    ------
    GraphnavError
        It is not installed, or one of its libraries is missing.
    """
    import ctypes
    import importlib

    try:
        library = importlib.import_module("libusb_package").get_library_path()
        if library is not None:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise GraphnavError(f"{error}, which creep needs; pip install 'graphnav[lidar]'") from error
    except (ImportError, OSError) as error:
        raise GraphnavError(
            f"Open3D cannot be loaded ({error}); it needs glibc 2.35 and the system's libraries of OpenGL: on Debian or"
            " Ubuntu apt-get install libgl1 libegl1 libx11-6 libudev1 libidn2-0"
        ) from error
