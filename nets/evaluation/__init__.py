"""Comparison of reconstruction methods on plates whose relief is known.

``method_spec`` is what is compared, ``fields`` what on, ``run`` one method on one image, ``scores`` how good the result
is, ``cells`` one result with its cost, kept on disk, ``schedule`` all of them, ``table`` what they say together.
"""
