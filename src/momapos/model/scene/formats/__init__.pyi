from .imported_room import ImportReport as ImportReport
from .importing import write_room as write_room
from .kinds import foreign_kind as foreign_kind
from .kinds import kind_of_file as kind_of_file
from .kinds import read_room as read_room
from .mjcf_writer import write_mjcf as write_mjcf
from .urdf_writer import obj_text as obj_text
from .urdf_writer import urdf_text as urdf_text
