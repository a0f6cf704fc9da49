"""The kinds of values in the tables of a scenario."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError, WrapValidator

from studies.scenario.refusal import as_toml, because

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
From = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, alias="from")]  # a beginning [s]
Text = Annotated[str, Field(strict=True, min_length=1, pattern=r"^[^\x00-\x1f\x7f]+$")]
Whole = Annotated[int, Field(strict=True, ge=1)]
Flag = Annotated[bool, Field(strict=True)]
Vector = tuple[Number, Number, Number]
Turn = tuple[Number, Number]


def one_sentence(allowed: str) -> WrapValidator:
    """Return a validator that refuses a value by one sentence.

    pydantic has one sentence for each member of a union. `allowed` is the name of the sentence in
    `refusals.toml`.
    """

    def validate(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(f" = {as_toml(value)} is refused: {because(allowed)}") from None

    return WrapValidator(validate)


def _check_shares(series: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Return a Prony series, or refuse a series whose shares leave no stiffness."""
    if sum(share for share, _ in series) >= 1.0:
        raise ValueError("the shares add up to one or more")
    return series


Series = Annotated[tuple[tuple[Positive, Positive], ...], AfterValidator(_check_shares), one_sentence("allowed-series")]
