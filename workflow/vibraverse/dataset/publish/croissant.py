"""The dataset's metadata in Croissant 1.0 (JSON-LD), which dataset searches and loaders read.

Vocabulary: http://mlcommons.org/croissant/1.0. The tables and all shards are files with checksums. The rows of the
index and of the splits are record sets; their fields state column, type and meaning.
"""

from __future__ import annotations

from vibraverse.dataset.publish.card import cite, licences
from vibraverse.dataset.schema import INDEX_COLUMNS, SPLIT_COLUMNS

_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    **{
        name: f"cr:{name}"
        for name in (
            "citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty", "fileObject", "fileSet",
            "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet",
            "references", "regex", "repeated", "replace", "samplingRate", "separator", "source", "subField",
            "transform",
        )
    },
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
}  # fmt: skip
_TYPES = {str: "sc:Text", int: "sc:Integer", float: "sc:Float"}
_ENCODINGS = {".tsv": "text/tab-separated-values", ".h5": "application/x-hdf5"}


def croissant(record: dict, card, files: dict[str, dict]) -> dict:
    """Return the JSON-LD of a dataset.

    ``record`` is the content of ``dataset.json``, ``card`` the section ``dataset.card`` of the configuration. ``files``
    maps paths in the dataset's folder to bytes and SHA-256. Keys without a value in ``card`` (address, date) are left
    out.
    """
    known = {
        "url": card.url,
        "datePublished": card.published,
        "version": card.version,
        "creator": [{"@type": "sc:Organization", "name": name} for name in card.creators],
    }
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": card.name,
        "description": card.description,
        "license": licences(record, card),
        **{name: value for name, value in known.items() if value},
        "citeAs": cite(card),
        "keywords": ["modal analysis", "impact sound", "3D shapes", "vibration", "materials"],
        "distribution": [_file(path, about) for path, about in files.items()],
        "recordSet": [
            _records("items", "index.tsv", INDEX_COLUMNS, ("object", "solidity", "material")),
            _records("splits", "splits.tsv", SPLIT_COLUMNS, ("object",)),
        ],
    }


def _file(path: str, about: dict) -> dict:
    return {
        "@type": "cr:FileObject",
        "@id": path,
        "name": path,
        "contentUrl": path,
        "contentSize": f"{about['bytes']} B",
        "encodingFormat": _ENCODINGS[path[path.rindex(".") :]],
        "sha256": about["sha256"],
    }


def _records(name: str, file: str, columns, key: tuple[str, ...]) -> dict:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "key": [{"@id": f"{name}/{column}"} for column in key],
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{name}/{column}",
                "name": column,
                "description": text,
                "dataType": _TYPES[kind],
                "source": {"fileObject": {"@id": file}, "extract": {"column": column}},
            }
            for column, (kind, text) in columns.items()
        ],
    }
