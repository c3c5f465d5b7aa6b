"""Puts a table into a page, between the marks that name the command which makes it.

write_table.py PAGE COMMAND TABLE
"""
import sys

page, command, table = sys.argv[1:]
begin, end = f"<!-- begin {command} -->\n", f"<!-- end {command} -->"
text = open(page).read()
if text.count(begin) != 1 or text.count(end) != 1:
    sys.exit(f"{page}: expected one pair of the lines {begin.strip()} and {end}")
before, rest = text.split(begin)
open(page, "w").write(before + begin + open(table).read() + "\n" + end + rest.split(end)[1])
