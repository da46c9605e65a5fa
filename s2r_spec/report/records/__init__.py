"""The JSON objects that commands print, each described by a record; their JSON Schemas are derived from these.

A frozen dataclass is an object that the command makes. A ``TypedDict`` is an object that another module, or a file,
gives as it is.
"""
