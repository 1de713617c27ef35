from .generate import SCHEMAS as SCHEMAS
from .generate import schema_of as schema_of
from .tables import field_list as field_list
