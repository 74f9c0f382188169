"""The clauses of the certificate, each with the change that switches it off and the tests that have to notice.

`mutation_check.py` (`make mutants`) applies them one at a time; `tests/test_mutants.py` checks that they still apply.
"""

from mutants.accepted import ACCEPTED
from mutants.batched import BATCHED
from mutants.clearance import CLEARANCE
from mutants.kinds import Edit, Mutant
from mutants.observed import OBSERVED
from mutants.owed import OWED
from mutants.places import PLACES
from mutants.road_traffic import ROAD_TRAFFIC
from mutants.roads import ROADS
from mutants.simulated import SIMULATED
from mutants.sources import SOURCES
from mutants.watched import WATCHED

__all__ = ["MUTANTS", "TABLES", "Edit", "Mutant"]

TABLES = {
    "accepted": ACCEPTED,
    "batched": BATCHED,
    "clearance": CLEARANCE,
    "observed": OBSERVED,
    "owed": OWED,
    "places": PLACES,
    "road_traffic": ROAD_TRAFFIC,
    "roads": ROADS,
    "simulated": SIMULATED,
    "sources": SOURCES,
    "watched": WATCHED,
}
MUTANTS = tuple(mutant for table in TABLES.values() for mutant in table)
