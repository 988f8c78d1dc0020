# caustic_shader_library(TARGET FOLDER LOOKUP): compiles every *.comp, *.vert and *.frag of FOLDER with glslang, checks it
# with spirv-val and embeds it in the static library TARGET. The C function LOOKUP (see shaders/shader_table.h) finds it
# under its file name. A shader that includes trace.glsl is compiled once per tracer and embedded as NAME.comp.bvh and
# NAME.comp.khr. Includes are searched in FOLDER, then in shaders/.
find_program(GLSLANG glslangValidator REQUIRED)
find_program(SPIRV_VAL spirv-val REQUIRED)

set(CAUSTIC_SHADER_FOLDER ${PROJECT_SOURCE_DIR}/shaders)
set(CAUSTIC_SHADER_TABLE ${PROJECT_SOURCE_DIR}/cmake/shader_table.c.in)

function(caustic_shader_library target folder lookup)
  file(GLOB sources CONFIGURE_DEPENDS ${folder}/*.comp ${folder}/*.vert ${folder}/*.frag)
  file(GLOB includes CONFIGURE_DEPENDS ${folder}/*.glsl ${folder}/shared/*.h
    ${CAUSTIC_SHADER_FOLDER}/*.glsl ${CAUSTIC_SHADER_FOLDER}/shared/*.h)
  set(binary_folder ${CMAKE_CURRENT_BINARY_DIR}/${target})
  file(MAKE_DIRECTORY ${binary_folder})

  set(outputs "")
  set(assembly "")
  set(table "")
  foreach(source ${sources})
    get_filename_component(file ${source} NAME)
    # Whether a shader traces decides its variants, so a changed shader configures again.
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${source})
    file(STRINGS ${source} traces REGEX "#include \"trace.glsl\"")
    set(variants plain)
    if(traces)
      set(variants bvh khr)
    endif()
    foreach(variant ${variants})
      set(name ${file})
      set(flags "")
      if(NOT variant STREQUAL "plain")
        set(name ${file}.${variant})
      endif()
      if(variant STREQUAL "khr")
        set(flags -DTRACER_KHR=1)
      endif()
      set(output ${binary_folder}/${name}.spv)
      add_custom_command(
        OUTPUT ${output}
        COMMAND sh ${PROJECT_SOURCE_DIR}/cmake/compile_shader.sh ${GLSLANG} ${SPIRV_VAL} ${source} ${output}
          -I${folder} -I${CAUSTIC_SHADER_FOLDER} ${flags}
        DEPENDS ${source} ${includes} ${PROJECT_SOURCE_DIR}/cmake/compile_shader.sh
        COMMENT "Shader ${name}"
        VERBATIM)
      list(APPEND outputs ${output})
      string(MAKE_C_IDENTIFIER "${lookup}_${name}" symbol)
      string(APPEND assembly
        "__asm__(\".section .rodata\\n.balign 4\\n.global ${symbol}\\n.global ${symbol}_end\\n${symbol}:\\n\"\n"
        "        \".incbin \\\"${output}\\\"\\n${symbol}_end:\\n.previous\\n\");\n"
        "extern const uint32_t ${symbol}[], ${symbol}_end[];\n")
      string(APPEND table "    {\"${name}\", ${symbol}, ${symbol}_end},\n")
    endforeach()
  endforeach()

  configure_file(${CAUSTIC_SHADER_TABLE} ${binary_folder}/shader_table.c @ONLY)
  set_source_files_properties(${binary_folder}/shader_table.c PROPERTIES OBJECT_DEPENDS "${outputs}")
  caustic_module(${target} SOURCES ${binary_folder}/shader_table.c)
endfunction()
