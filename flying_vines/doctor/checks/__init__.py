"""The doctor's checks, one file per subject: the facts, all possible lines, and the check itself.

All pure: facts in, findings out.
"""
