"""All kinds of crash."""

from tests.logs.strangers_kinds.death_kinds import DEATH_KINDS, FORM_KINDS
from tests.logs.strangers_kinds.message_kinds import MESSAGE_KINDS
from tests.logs.strangers_kinds.state_kinds import STATE_KINDS
from tests.logs.strangers_kinds.time_kinds import TIME_KINDS
from tests.logs.strangers_kinds.world_kinds import WORLD_KINDS

KINDS = [*MESSAGE_KINDS, *TIME_KINDS, *STATE_KINDS, *DEATH_KINDS, *FORM_KINDS, *WORLD_KINDS]
