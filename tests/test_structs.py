import numpy as np
import pytest

from clgrid import program, structs
from clgrid.device import Device
from clgrid.errors import DeviceError


def test_every_struct_is_laid_out_on_the_device_as_in_numpy(device: Device) -> None:
    program.check_structs(device)


def test_a_struct_that_needs_hidden_padding_is_found_out(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    uneven = structs.Struct("UnevenParams", (("uint", "count", 1), ("double", "size", 1)))
    program.check_structs(device, (uneven,))
    packed = np.dtype([("count", np.uint32), ("size", np.float64)])
    monkeypatch.setattr(structs.Struct, "dtype", property(lambda self: packed))
    with pytest.raises(DeviceError, match=r"sizeof UnevenParams is 16 bytes on the device and 12 in numpy"):
        program.check_structs(device, (uneven,))


def test_pack_places_every_member() -> None:
    record = structs.FRAME.pack(offset=(1.0, 2.0, 3.0), scale=0.5, inverse_scale=2.0)
    assert record["offset"].tolist() == [1.0, 2.0, 3.0]
    assert np.frombuffer(record.tobytes(), np.float64).tolist() == [1.0, 2.0, 3.0, 0.5, 2.0]


@pytest.mark.parametrize(
    "values", [{"scale": 1.0}, {"offset": 0, "scale": 1, "inverse_scale": 1, "extra": 1}]
)
def test_pack_refuses_missing_and_unknown_members(values: dict[str, float]) -> None:
    with pytest.raises(KeyError, match="FrameParams"):
        structs.FRAME.pack(**values)


def test_a_declaration_lists_the_members_in_order() -> None:
    members = "    double offset[3];\n    double scale;\n    double inverse_scale;\n"
    assert structs.FRAME.declaration() == f"typedef struct {{\n{members}}} FrameParams;\n"


def test_no_struct_of_the_table_has_padding() -> None:
    for struct in structs.ALL:
        members = sum(
            np.dtype(structs._C_TYPES[ctype]).itemsize * count for ctype, _, count in struct.members
        )
        assert members == struct.dtype.itemsize, struct.name
