"""Reports of a run, as a table and as one self-contained page; and recordings of users, read and checked."""
