"""What was once done to the server, and the tests that hold what it does today.

Each row is an attack in words, and the tests (FILE::NAME, below tests/server) that fail if it ever
works again. A test that is renamed is renamed here too.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent

HELD_BY = {
    "idle connections take all descriptors; the log is flooded, nobody else is served": (
        "operate/test_operated.py::test_idle_clients_beyond_all_descriptors_are_waited_out_quietly",
        "operate/test_admission.py::test_connections_stay_below_the_limit_of_open_files",
        "operate/test_operated.py::test_connections_above_the_limit_wait_and_are_served",
        "library/test_library.py::test_a_process_without_descriptors_keeps_what_it_serves",
    ),
    "one bad folder beside good ones keeps the server from starting": (
        "test_main.py::test_a_broken_stream_is_named_and_the_others_are_served",
        "library/test_library.py::test_a_broken_stream_is_named_with_its_reason_and_the_others_are_served",
        "library/test_library.py::test_a_name_that_needs_quoting_is_refused_and_shown_without_harm",
    ),
    "a Host that is not one makes a page a 500 with a traceback": (
        "hostile/test_hostile_requests.py::test_it_is_answered_as_http_says_and_nothing_else_happens",
        "http/test_request.py::test_any_bytes_give_a_request_or_an_error",
        "http/test_fuzz.py::test_each_is_answered_well",
    ),
    "a stream that was seen half copied is never served": (
        "library/test_watch.py::test_a_half_copied_stream_is_broken_until_it_is_whole",
        "library/test_watch.py::test_an_index_that_is_copied_before_its_objects_waits_for_them",
    ),
    "a deleted stream stays listed; a replaced one has new bytes under an old tag, or is mixed": (
        "library/test_watch.py::test_streams_come_go_break_and_are_repaired",
        "library/test_watch.py::test_a_replaced_stream_is_another_one",
        "library/test_streamview.py::test_whatever_is_put_in_its_place_a_tag_never_changes_its_bytes",
        "test_growing.py::test_a_replaced_stream_ends_its_plays_and_no_tag_has_two_contents",
    ),
    "a manifest without an end takes all memory": (
        "library/test_library.py::test_a_broken_stream_is_named_with_its_reason_and_the_others_are_served",
    ),
    "a FIFO in place of an object blocks a thread for ever": (
        "library/test_library.py::test_objects_are_regular_files_of_the_right_size",
    ),
    "a slow but honest reader is cut, and can never have a large object": (
        "hostile/test_slow_clients.py::test_a_reader_of_10_kb_a_second_gets_its_whole_object",
        "http/test_outlet.py::test_who_stalls_is_who_had_something_to_take_and_did_not",
    ),
    "a time without an end is a traceback": (
        "operate/test_operated.py::test_times_without_an_end_are_refused_in_one_line",
        "http/test_connection.py::test_times_that_make_no_sense_are_refused",
    ),
    "plays that are stuck keep a server that was told to end": (
        "operate/test_operated.py::test_plays_that_are_stuck_do_not_keep_a_server_that_shall_end",
    ),
    "of two lines of If-None-Match only the first is read; If-Match is not read at all": (
        "http/test_content.py::test_it_is_as_the_rfc_says",
        "http/test_request.py::test_fields_of_one_name_are_one_list",
        "hostile/test_hostile_requests.py::test_it_is_answered_as_http_says_and_nothing_else_happens",
    ),
    "HTTP/2.0 on the port gets a 200": ("http/test_request.py::test_lines_that_are_not_taken",),
    "one client takes all plays, or all connections": (
        "operate/test_operated.py::test_one_client_of_a_proxy_has_so_many_plays",
        "operate/test_operated.py::test_a_stranger_cannot_say_who_it_is",
        "operate/test_operated.py::test_one_address_has_so_many_connections",
        "operate/test_admission.py::test_one_address_cannot_take_all_places",
    ),
    "plays that began together burst in step": (
        "abr/test_told.py::test_clients_that_began_together_drift_apart",
    ),
    "what strangers send reaches the operator's terminal as escapes": (
        "operate/log/test_logline.py::test_whatever_a_field_holds_the_line_is_one_and_printable",
        "library/test_library.py::test_the_reason_of_a_stranger_is_one_line_of_letters",
        "operate/test_operated.py::test_every_line_of_a_json_log_is_json",
    ),
    "requests without an end, whose answers nobody takes, fill the memory": (
        "http/test_connection.py::test_a_flood_of_requests_is_bounded_and_others_have_their_turn",
    ),
    "handshakes that fail use up what one address may have": (
        "http/test_outlet.py::test_strangers_at_the_tls_port_leave_nothing_behind",
    ),
}


@pytest.mark.parametrize("attack", HELD_BY)
def test_it_is_held(attack: str) -> None:
    for test in HELD_BY[attack]:
        file, name = test.split("::")
        tree = ast.parse((HERE / file).read_text(encoding="utf-8"))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert name in names, test
