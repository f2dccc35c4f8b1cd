"""Map files: everything that is remembered of a taught path, in one SQLite file."""

from autoexpose_daemon.navigation.store.database import MapError
from autoexpose_daemon.navigation.store.map_file import MapFile
from autoexpose_daemon.navigation.store.rows import MapInfo, Place, Run, TaughtPlace, newest_of_hour

__all__ = ["MapError", "MapFile", "MapInfo", "Place", "Run", "TaughtPlace", "newest_of_hour"]
