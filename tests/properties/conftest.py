"""How many examples the properties are tried on: a few, always the same; or many new ones, EVOGYMCM_EXAMPLES=N of each.

`scripts/fuzz.sh` does the second. What fails is shrunk to the smallest example that fails, which then becomes a test of
its own beside the code where the fault was.
"""

import os

from hypothesis import HealthCheck, settings

_MANY = os.environ.get("EVOGYMCM_EXAMPLES")
_ANY = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]}

settings.register_profile("quick", max_examples=12, derandomize=True, database=None, **_ANY)
settings.register_profile("long", max_examples=int(_MANY or 1), print_blob=True, **_ANY)
settings.load_profile("long" if _MANY else "quick")
