"""What logs that others wrote leave unsaid."""

from functools import cache

from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.schema import layout
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.registry import stock_registry


def version_of_foreign(type_name: str, schema: str) -> int:
    """Return which version of a type a schema is: that of the stock type if they lay out alike, else 1."""
    types = _stock()
    if type_name not in types or not schema:
        return 1
    ours = types.get(type_name)
    try:
        same = layout(message_type_from_schema(type_name, schema)) == layout(ours)
    except MessageError:
        return 1
    return ours.version if same else 1


@cache
def _stock() -> TypeRegistry:
    return stock_registry()
