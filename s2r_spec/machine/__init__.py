"""One robot and one operator: rollouts that run one at a time, each confirmed by a person."""
