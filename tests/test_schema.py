"""Models, variants and column types of the schema."""

from oes import schema
from oes.dynamics import MODELS, VARIANTS


def test_every_model_has_a_label_and_every_variant_its_settings() -> None:
    assert set(MODELS) == set(schema.MODEL_LABELS) - set(schema.IMAGE_MODELS)
    assert list(VARIANTS) == list(schema.VARIANT_LABELS) and set(VARIANTS.values()) <= set(MODELS)


def test_every_column_has_a_known_type() -> None:
    tables = (schema.ERRORS, schema.DETECTIONS, schema.VIEWS, schema.TRIALS, schema.FORECASTS)
    for columns in (*tables, *schema.FUTURES.values()):
        assert set(columns.values()) <= {"str", "int", "float", "float?", "bool"}
