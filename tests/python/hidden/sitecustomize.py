"""Makes iceoryx2 missing, or another version, to the Python that finds this module: TECTUM_TEST_ICEORYX2."""

import importlib.metadata
import os
import sys

wanted, found = os.environ.get("TECTUM_TEST_ICEORYX2"), importlib.metadata.version


def version(name):
    if name != "iceoryx2":
        return found(name)
    if wanted == "missing":
        raise importlib.metadata.PackageNotFoundError(name)
    return wanted


if wanted:
    importlib.metadata.version = version
    if wanted == "missing":
        sys.modules["iceoryx2"] = None
