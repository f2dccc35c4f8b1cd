"""Map files: everything that is remembered of a taught path, in one SQLite file."""

from navigation.store.map_file import MapFile
from navigation.store.rows import MapDrive, MapError, MapInfo, Place, TaughtPlace, newest_of_hour

__all__ = ["MapDrive", "MapError", "MapFile", "MapInfo", "Place", "TaughtPlace", "newest_of_hour"]
