import pytest

from armdyn import codegen


@pytest.fixture(scope="module", autouse=True)
def virtual_machine():
    """Two dozen formulations on short runs: compiling them would take longer than running them."""
    patch = pytest.MonkeyPatch()
    patch.setenv(codegen.COMPILE_VARIABLE, "0")
    codegen.find_compiler.cache_clear()
    yield
    patch.undo()
    codegen.find_compiler.cache_clear()
