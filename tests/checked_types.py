"""The type checker of the tests: beartype, with int taken for float and float for complex as PEP 484 has it."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
