"""Cameras through Aravis: find them, open one by its serial number, stream frames."""

from drivers.aravis.camera import AravisCamera
from drivers.aravis.opening import FoundCamera, find_cameras, open_camera, open_nodes

__all__ = ["AravisCamera", "FoundCamera", "find_cameras", "open_camera", "open_nodes"]
