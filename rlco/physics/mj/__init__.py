"""MuJoCo's C functions and structs, callable without the GIL."""
