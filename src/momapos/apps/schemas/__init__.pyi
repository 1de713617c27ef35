from .generate import SCHEMAS as SCHEMAS
from .generate import field_list as field_list
from .generate import schema_of as schema_of
