"""What the doctor looks at, a file each: the facts, the lines that can be said of them, and which hold.

All pure: facts in, findings out.
"""
