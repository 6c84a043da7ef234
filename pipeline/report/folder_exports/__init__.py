"""A finished run as a folder that another program opens: one writer a program, and one table of them (`registry`)."""
