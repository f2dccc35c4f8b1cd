"""Map files: everything that is remembered of a taught path, in one SQLite file."""

from navigation.store.map_file import MapFile
from navigation.store.rows import MapDrive, MapError, MapInfo, Place, newest_of_hour, write

__all__ = ["MapDrive", "MapError", "MapFile", "MapInfo", "Place", "newest_of_hour", "write"]
