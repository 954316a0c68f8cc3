"""Documents checked with the printed schemas, by a validator that shares no code with the program."""

import copy
import json

from jsonschema import Draft202012Validator

from daemon import stictiond

_validators = {}


def parsed(text):
    """JSON; the words NaN and Infinity are invalid."""
    def refuse(word):
        raise ValueError(f"{word} is no JSON")
    return json.loads(text, parse_constant=refuse)


def faults(document):
    """Violations of the schema that the document names."""
    name = document["schema"]
    if name not in _validators:
        code, out, err = stictiond("schema", name)
        assert code == 0, err
        schema = parsed(out)
        Draft202012Validator.check_schema(schema)
        _validators[name] = Draft202012Validator(schema)
    return [f"{'/'.join(map(str, e.absolute_path))}: {e.message[:200]}" for e in _validators[name].iter_errors(document)]


def check_document(document):
    found = faults(document)
    assert not found, f"{document['schema']} of {document.get('loop')}: {found}"


def test_documents_fit_their_schemas(folder):
    code, out, err = stictiond("schema")
    assert code == 0, err
    names = out.split()
    assert {
        f"stictiond.{name}" for name in ("estimate.v1", "alarm.v2", "gap.v1", "group.v1", "loop_health.v1", "daemon_health.v1", "data_health.v1")
    } == set(names)
    code, out, err = stictiond("analyze", "recordings/four-loops.mcap", "--format", "json")
    assert code == 0, err
    estimates = [parsed(line) for line in out.splitlines()]
    code, out, err = stictiond("gap", "recordings/sticking.mcap", "--budget", "1", "--format", "json")
    assert code == 0, err
    documents = estimates + [parsed(line) for line in out.splitlines()]
    assert len(documents) > 4, len(documents)
    for document in documents:
        check_document(document)
        # The schemas do detect violations: a missing field, and text instead of a number.
        for field in ("loop", "version", "window"):
            less = {k: v for k, v in document.items() if k != field}
            assert faults(less), f"{document['schema']} without {field} passes"
        other = copy.deepcopy(document)
        other["window"]["ts_s"] = "1 s"
        assert faults(other), document["schema"]
        other["window"]["ts_s"] = None
        assert faults(other), document["schema"]
