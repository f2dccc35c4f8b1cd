"""Cameras through Aravis: find them, open one by its serial number, stream frames."""

from drivers.aravis.camera import AravisCamera
from drivers.aravis.discovery import FoundCamera, find_cameras
from drivers.aravis.opening import open_camera, open_nodes

__all__ = ["AravisCamera", "FoundCamera", "find_cameras", "open_camera", "open_nodes"]
