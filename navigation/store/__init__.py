"""Map files: everything that is remembered of a taught path, in one SQLite file."""

from navigation.store.map_file import MapFile
from navigation.store.rows import MapError, MapInfo, Place, Run, TaughtPlace, newest_of_hour

__all__ = ["MapError", "MapFile", "MapInfo", "Place", "Run", "TaughtPlace", "newest_of_hour"]
