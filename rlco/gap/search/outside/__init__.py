"""What acts outside the library: doubt by a free form, and searches beside one."""
