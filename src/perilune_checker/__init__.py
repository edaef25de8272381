"""Check certificates of theorems with nothing of the library that wrote them: needs python-flint only.

`certificate` reads, `expressions` differentiates, `equations` states Pontryagin's conditions, `taylor_steps` encloses
flights, `hamiltonian_minimum` and `second_variation` decide optimality; `check` is the whole.
"""
