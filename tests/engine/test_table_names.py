"""Tables are called as the headings above them."""

from spl_batch.engine.report.table_names import named_tables

TABLE = '<div class="scroll" tabindex="0"><table class="x"></table></div>'


def test_a_table_is_called_as_its_heading_and_a_second_one_is_counted() -> None:
    page = f'{TABLE}<h2 id="a">One <b>&amp; all</b></h2>{TABLE}<p>{TABLE}<h3>"Two"</h3>{TABLE}'
    made = named_tables(page)
    names = ["Table", "One &amp; all", "One &amp; all, table 2", "&quot;Two&quot;"]
    for name in names:
        assert (
            f'role="region" aria-label="{name}, scrolls"><table aria-label="{name}" class' in made
        )
    assert made.count("aria-label") == 2 * len(names)
    assert named_tables("<p>no table</p>") == "<p>no table</p>"
