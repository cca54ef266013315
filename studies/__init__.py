"""The measurements of the papers that Cardan follows, repeated: one report (``cardan evaluate``).

Each study is a folder: it measures, and gives tables of what was published beside what was
measured, figures that another report's are compared with, and pictures.
"""
